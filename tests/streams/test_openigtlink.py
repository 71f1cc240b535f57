"""OpenIGTLink on the wire, against bytes laid out by hand, pyigtl, and an independent CRC."""

import struct
from collections import Counter
from contextlib import suppress

import crcmod
import numpy as np
import pyigtl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carm_kin.streams import openigtlink as igtl
from carm_kin.streams import tracking
from carm_kin.streams.openigtlink import Decoder, Message, ProtocolError

TYPES = (*tracking.TYPES, "STATUS")
ecma_182 = crcmod.mkCrcFun(0x142F0E1EBA9EA3693, rev=False, initCrc=0, xorOut=0)


def header(kind=b"TRANSFORM", device=b"Tool", stamp=0, size=0, crc=0, version=1) -> bytes:
    """A header laid out by hand."""
    return struct.pack(">H12s20sQQQ", version, kind, device, stamp, size, crc)


def framed(body: bytes, **fields) -> bytes:
    return header(size=len(body), crc=ecma_182(body), **fields) + body


def decoded(data: bytes, counts: Counter | None = None) -> list[Message]:
    return list(Decoder(TYPES, Counter() if counts is None else counts).feed(data))


def test_the_crc_is_that_of_ecma_182():
    # The check value of CRC-64/ECMA-182 in the catalogue of parametrised CRC algorithms.
    assert igtl.crc64(b"123456789") == 0x6C40DF5F0B497347


@given(st.binary(max_size=300))
def test_the_crc_agrees_with_crcmod(data):
    assert igtl.crc64(data) == ecma_182(data)


def test_a_message_of_version_1_by_hand():
    body = struct.pack(">12f", *range(12))
    stamp = (1_700_000_000 << 32) | (1 << 31)
    (message,) = decoded(framed(body, device=b"ProbeToTracker", stamp=stamp))
    assert message == Message("TRANSFORM", "ProbeToTracker", body, 1_700_000_000.5)


def test_a_message_of_version_2_by_hand():
    content = struct.pack(">12f", *range(12))
    values = b"TransformStatusOKTransformValidTrue"
    index = struct.pack(">H", 2) + struct.pack(">HHI", 15, 3, 2) + struct.pack(">HHI", 14, 3, 4)
    body = struct.pack(">HHII", 12, len(index), len(values), 77) + content + index + values
    (message,) = decoded(framed(body, version=2))
    assert message == Message(
        "TRANSFORM", "Tool", content, None, 77, {"TransformStatus": "OK", "TransformValid": "True"}
    )


def test_an_extended_header_that_is_longer_than_ours_is_passed_over():
    content = struct.pack(">12f", *range(12))
    body = struct.pack(">HHII", 20, 2, 0, 5) + bytes(8) + content + bytes(2)
    (message,) = decoded(framed(body, version=2))
    assert (message.content, message.number) == (content, 5)


@pytest.mark.parametrize("version", [1, 2])
def test_pyigtl_writes_what_we_read(version):
    matrix = np.arange(16.0).reshape(4, 4)
    theirs = pyigtl.TransformMessage(matrix, timestamp=1234.25, device_name="Stylus")
    theirs.header_version, theirs.message_id = version, 9
    theirs.metadata = {"TransformStatus": "MISSING", "name": "x"} if version == 2 else {}
    (message,) = decoded(theirs.pack())
    assert (message.type, message.device, message.metadata) == ("TRANSFORM", "Stylus", theirs.metadata)
    assert message.stamp_s == pytest.approx(1234.25, abs=1e-6)
    assert message.number == (9 if version == 2 else 0)
    assert message.content == matrix[:3].T.astype(">f4").tobytes()


@pytest.mark.parametrize("version", [1, 2])
def test_pyigtl_reads_what_we_write(version):
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    T[:3, 3] = 0.1, -0.2, 0.3
    data = igtl.encode(tracking.transform_message("Marker", T, 1234.25, 9), version)
    fields = pyigtl.messages.MessageBase.parse_header(data[:58])
    assert fields["body_size"] == len(data) - 58
    theirs = pyigtl.messages.MessageBase.create_message(fields["message_type"])
    theirs.unpack(fields, data[58:])
    assert (theirs.device_name, theirs.header_version) == ("Marker", version)
    assert theirs.timestamp == pytest.approx(1234.25, abs=1e-6)
    np.testing.assert_allclose(theirs.matrix[:3, 3], [100, -200, 300], atol=1e-4)
    np.testing.assert_array_equal(theirs.matrix[:3, :3], T[:3, :3])
    assert struct.unpack(">Q", data[50:58])[0] == ecma_182(data[58:])
    if version == 2:
        assert theirs.metadata == {"TransformValid": "True", "TransformStatus": "OK"}
        assert theirs.message_id == 9


def test_a_long_name_survives_in_version_2_and_is_cut_in_version_1():
    message = Message("TRANSFORM", "StylusTipToReferenceTransform", bytes(48))
    assert decoded(igtl.encode(message))[0].device == "StylusTipToReferenceTransform"
    assert decoded(igtl.encode(message, version=1))[0].device == "StylusTipToReference"


@given(
    st.lists(
        st.builds(
            Message,
            st.sampled_from(TYPES),
            st.text("abcXYZ-_ é", min_size=1, max_size=30).map(str.strip).filter(bool),
            st.binary(max_size=200),
            st.integers(1, 2**40 - 1).map(lambda n: n / 256),
            st.integers(0, 2**32 - 1),
            st.dictionaries(st.text("abc", min_size=1), st.text("xyzé", min_size=1), max_size=3),
        ),
        max_size=5,
    ),
    st.data(),
)
def test_messages_come_back_however_the_stream_is_cut(messages, data):
    stream = b"".join(map(igtl.encode, messages))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    decoder, found = Decoder(TYPES, Counter()), []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += decoder.feed(stream[begin:end])
    assert [(m.type, m.device, m.content, m.stamp_s, m.number) for m in found] == [
        (m.type, m.device, m.content, m.stamp_s, m.number) for m in messages
    ]
    for there, here in zip(found, messages, strict=True):
        assert {k: v for k, v in there.metadata.items() if k != igtl.FULL_NAME} == here.metadata


def test_a_byte_at_a_time():
    stream = framed(bytes(48)) + framed(bytes(48), device=b"B")
    decoder = Decoder(TYPES, Counter())
    found = [message for byte in stream for message in decoder.feed(bytes([byte]))]
    assert [message.device for message in found] == ["Tool", "B"]


def test_a_wrong_crc_costs_one_message_only():
    counts = Counter()
    damaged = bytearray(framed(bytes(48)))
    damaged[70] ^= 1
    found = decoded(framed(bytes(48), device=b"A") + damaged + framed(bytes(48), device=b"C"), counts)
    assert [message.device for message in found] == ["A", "C"]
    assert counts == {igtl.WRONG_CRC: 1}


@pytest.mark.parametrize(
    "body",
    [
        b"",
        bytes(11),
        struct.pack(">HHII", 11, 0, 0, 0),
        struct.pack(">HHII", 13, 0, 0, 0),
        struct.pack(">HHII", 12, 1, 0, 0) + bytes(1),
        struct.pack(">HHII", 12, 0, 2**32 - 1, 0),
        struct.pack(">HHII", 12, 65535, 0, 0) + bytes(100),
        struct.pack(">HHII", 12, 2, 0, 0) + struct.pack(">H", 65535),
        struct.pack(">HHII", 12, 10, 3, 0) + struct.pack(">HHHI", 1, 2, 3, 2) + b"abc",
        struct.pack(">HHII", 12, 10, 3, 0) + struct.pack(">HHHI", 1, 0, 3, 2**32 - 1) + b"abc",
    ],
)
def test_sizes_that_contradict_each_other_are_counted(body):
    counts = Counter()
    found = decoded(framed(body, version=2) + framed(bytes(48), device=b"next"), counts)
    assert [message.device for message in found] == ["next"]
    assert counts == {igtl.MALFORMED: 1}


@pytest.mark.parametrize(
    "head, words",
    [
        (header(size=2**40), "claims 1,099,511,627,776 bytes"),
        (header(size=2**64 - 1), "TRANSFORM claims"),
        (header(b"IMAGE", size=2**40), "IMAGE claims"),
        (header(version=0), "version 0"),
        (header(version=0x4854), "no OpenIGTLink"),
        (header(kind=b""), "no OpenIGTLink"),
        (header(kind=b"\xff\xfe\x80"), "no OpenIGTLink"),
        (header(kind=b"A B"), "no OpenIGTLink"),
        (b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain\r\nConnection: close\r\n", "no OpenIGTLink"),
    ],
)
def test_what_cannot_be_followed_is_an_error_after_what_came_before(head, words):
    messages = Decoder(TYPES, Counter()).feed(framed(bytes(48), device=b"before") + head)
    assert next(messages).device == "before"
    with pytest.raises(ProtocolError, match=words):
        next(messages)


def test_other_types_are_passed_over_without_being_kept():
    counts = Counter()
    decoder = Decoder(TYPES, counts)
    size = 20_000_000
    assert list(decoder.feed(header(b"IMAGE", size=size))) == []
    piece = bytes(1 << 16)
    for _ in range(size // len(piece)):
        assert list(decoder.feed(piece)) == []
        assert len(decoder._buffer) <= len(piece)
    (message,) = decoder.feed(bytes(size % len(piece)) + framed(bytes(48)))
    assert (message.device, counts) == ("Tool", {"IMAGE": 1})


def test_the_counters_stay_few():
    counts = Counter()
    decoded(b"".join(header(f"T{k}".encode()) for k in range(1000)), counts)
    assert len(counts) <= igtl.MAX_COUNTED + 1
    assert counts.total() == 1000


@given(st.binary(max_size=400))
def test_noise_is_an_error_or_nothing(noise):
    decoder = Decoder(TYPES, Counter())
    try:
        assert list(decoder.feed(noise)) == []
    except ProtocolError:
        return
    assert len(decoder._buffer) <= len(noise)


@given(st.integers(0, 57), st.integers(0, 255))
def test_a_damaged_header_never_gives_a_wrong_pose(at, value):
    """A changed byte of the header changes what it says, or the message is lost; the content stays or goes."""
    body = struct.pack(">12f", *range(12))
    data = bytearray(framed(body) + framed(body, device=b"next"))
    data[at] = value
    with suppress(ProtocolError):
        for message in Decoder(TYPES, Counter()).feed(bytes(data)):
            assert message.content == body


def test_text_of_strangers_is_shown_safely():
    assert igtl.text(b"a\x1b[31mb\xff\nc\0rest") == "a?[31mb??c"
