"""OpenIGTLink on the wire: messages to bytes, and back from bytes that arrive in pieces and may be hostile.

A message is a header of 58 bytes (version, type, device, time, size and CRC of the body) and a body. With header
version 2 the body is an extended header, the content, and metadata: pairs of key and value. Numbers are big-endian.
"""

import struct
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field

from carm_kin.errors import CarmKinError

PORT = 18944
"""The usual TCP port."""
VERSIONS = (1, 2)
"""Header versions that are read."""
MAX_BODY = 1 << 16
"""Bytes of the largest body that is read: some 900 tools."""
MAX_SKIPPED = 1 << 28
"""Bytes of the largest body of another type that is passed over; a larger one is a fault of the stream."""
WRONG_CRC, MALFORMED, OTHERS = "wrong CRC", "malformed", "other types"
MAX_COUNTED = 50
"""Types that are counted by name."""
NAME_BYTES = 20
"""Bytes of a name in a header."""
FULL_NAME = "IGTL_DEVICE_NAME"
"""The key of metadata that holds a longer name."""

_HEADER = struct.Struct(">H12s20sQQQ")
_EXTENDED = struct.Struct(">HHII")
_COUNT = struct.Struct(">H")
_ENTRY = struct.Struct(">HHI")
_US_ASCII, _UTF_8 = 3, 106
"""Numbers of character sets in the registry of the IANA."""


class ProtocolError(CarmKinError):
    """What arrives is no OpenIGTLink; where the next message begins is unknown."""


@dataclass(frozen=True)
class Message:
    """One message without its framing."""

    type: str
    device: str
    content: bytes
    stamp_s: float | None = None
    """When the server says that it was made, s since 1970; None where it does not say."""
    number: int = 0
    """The message's number; 0 where the server counts none."""
    metadata: Mapping[str, str] = field(default_factory=dict)


def _table() -> tuple[int, ...]:
    """The CRC of every byte."""
    rows = []
    for byte in range(256):
        crc = byte << 56
        for _ in range(8):
            crc = (crc << 1) ^ (0x142F0E1EBA9EA3693 if crc >> 63 else 0)
        rows.append(crc)
    return tuple(rows)


_TABLE = _table()
_LOW = (1 << 56) - 1


def crc64(data: bytes) -> int:
    """The cyclic redundancy check of ECMA-182, from zero, as the protocol takes it of the body."""
    crc = 0
    for byte in data:
        crc = (crc & _LOW) << 8 ^ _TABLE[crc >> 56 ^ byte]
    return crc


def encode(message: Message, version: int = 2) -> bytes:
    """The bytes of a message; version 1 holds neither number nor metadata, and cuts the device's name to 20 bytes."""
    name = message.device.encode()
    body = message.content
    if version > 1:
        more = {FULL_NAME: message.device} if len(name) > NAME_BYTES else {}
        index, values = _encoded_metadata({**message.metadata, **more})
        body = _EXTENDED.pack(_EXTENDED.size, len(index), len(values), message.number) + body + index + values
    stamp = round((message.stamp_s or 0.0) * 2**32)
    return _HEADER.pack(version, message.type.encode(), name[:NAME_BYTES], stamp, len(body), crc64(body)) + body


def _encoded_metadata(metadata: Mapping[str, str]) -> tuple[bytes, bytes]:
    index, values = _COUNT.pack(len(metadata)), b""
    for key, value in metadata.items():
        pair = key.encode(), value.encode()
        index += _ENTRY.pack(len(pair[0]), _US_ASCII if value.isascii() else _UTF_8, len(pair[1]))
        values += b"".join(pair)
    return index, values


class Decoder:
    """Messages from bytes, however these are cut into pieces."""

    def __init__(self, types: Collection[str], counts: Counter[str]) -> None:
        """Messages of other types are passed over.

        In `counts` is counted how often: `WRONG_CRC`, `MALFORMED`, and each type that was passed over.
        """
        self._types = types
        self._counts = counts
        self._buffer = bytearray()
        self._skip = 0

    def feed(self, data: bytes) -> Iterator[Message]:
        """The messages that are complete with these bytes.

        Those with a wrong CRC or a malformed body are counted and left out. Raises ProtocolError after the last
        sound message where the stream cannot be followed; the decoder is of no use then.
        """
        self._buffer += data
        while self._skipped() and len(self._buffer) >= _HEADER.size:
            version, raw_type, raw_device, stamp, size, crc = _HEADER.unpack_from(self._buffer)
            kind = self._checked(version, raw_type, size)
            if kind not in self._types:
                self._counts[kind if len(self._counts) < MAX_COUNTED else OTHERS] += 1
                self._skip = _HEADER.size + size
                continue
            if len(self._buffer) < _HEADER.size + size:
                return
            body = bytes(self._buffer[_HEADER.size : _HEADER.size + size])
            del self._buffer[: _HEADER.size + size]
            if crc64(body) != crc:
                self._counts[WRONG_CRC] += 1
                continue
            try:
                number, content, metadata = _parts(body) if version > 1 else (0, body, {})
            except (struct.error, ValueError):
                self._counts[MALFORMED] += 1
                continue
            device = metadata.get(FULL_NAME) or text(raw_device)
            yield Message(kind, device, content, stamp / 2**32 if stamp else None, number, metadata)

    def _skipped(self) -> bool:
        """Pass over what is to be skipped; False where its end has not arrived."""
        passed = min(self._skip, len(self._buffer))
        del self._buffer[:passed]
        self._skip -= passed
        return not self._skip

    def _checked(self, version: int, raw_type: bytes, size: int) -> str:
        kind = text(raw_type)
        if version not in VERSIONS or not kind or not (kind.isascii() and kind.replace("_", "").isalnum()):
            raise ProtocolError(f"a header has the version {version} and the type '{kind}': this is no OpenIGTLink")
        most = MAX_BODY if kind in self._types else MAX_SKIPPED
        if size > most:
            raise ProtocolError(f"a message {kind} claims {size:,} bytes; at most {most:,} are read")
        return kind


def _parts(body: bytes) -> tuple[int, bytes, dict[str, str]]:
    """Number, content and metadata. Raises ValueError or struct.error where the sizes do not fit each other."""
    begin, index_size, values_size, number = _EXTENDED.unpack_from(body)
    end = len(body) - index_size - values_size
    if begin < _EXTENDED.size or end < begin:
        raise ValueError
    index, at = body[end : end + index_size], end + index_size
    metadata = {}
    for k in range(_COUNT.unpack_from(index)[0] if index_size else 0):
        key_size, _, value_size = _ENTRY.unpack_from(index, _COUNT.size + k * _ENTRY.size)
        if at + key_size + value_size > len(body):
            raise ValueError
        metadata[text(body[at : at + key_size])] = text(body[at + key_size : at + key_size + value_size])
        at += key_size + value_size
    return number, body[begin:end], metadata


def text(raw: bytes) -> str:
    """Text up to the first NUL; what cannot be shown becomes a question mark."""
    decoded = raw.partition(b"\0")[0].decode("utf-8", "replace").strip()
    return "".join(c if c.isprintable() and c != "\N{REPLACEMENT CHARACTER}" else "?" for c in decoded)
