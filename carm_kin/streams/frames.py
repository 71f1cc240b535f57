"""Frames of the tool that is captured: its pose, in the frame of the tracker or of a reference tool."""

from dataclasses import dataclass

from carm_kin.streams.openigtlink import NAME_BYTES
from carm_kin.streams.tracking import Observation
from solvers.se3 import Array, inverse

SAME_S = 0.002
"""Stamps of tool and reference that differ by no more are of one moment."""
NO_REFERENCE = "no reference"


@dataclass(frozen=True, eq=False)
class Frame:
    """The tool at one moment."""

    time_s: float
    """The server's stamp; where it gives none, `received_s`."""
    received_s: float
    """When it arrived, s since 1970 by this computer's clock."""
    T: Array | None
    """(4, 4), m; None where there is no pose."""
    fault: str = ""
    """Why there is none."""


class Frames:
    """Frames of one tool from observations of all.

    With a reference, ``T_reference_tool = inverse(T_tracker_reference) @ T_tracker_tool`` of one moment; a tool waits
    for its reference until something later arrives.
    """

    def __init__(self, tool: str, reference: str | None = None) -> None:
        self.tool = tool
        self.reference = reference
        self._seen: Frame | None = None
        self._waiting: Frame | None = None

    def add(self, observation: Observation, received_s: float) -> list[Frame]:
        """The frames that are complete with this observation; none for other tools."""
        time_s = received_s if observation.stamp_s is None else observation.stamp_s
        frame = Frame(time_s, received_s, observation.T, observation.fault)
        if self.of_tool(observation):
            return [frame] if self.reference is None else self._with_tool(frame)
        known = self.reference is not None and _same(self.reference, observation.tool)
        return self._with_reference(frame) if known else []

    def of_tool(self, observation: Observation) -> bool:
        """Whether it is of the tool that is captured."""
        return _same(self.tool, observation.tool)

    def rest(self) -> list[Frame]:
        """The frame that still waits for its reference."""
        waiting, self._waiting = self._waiting, None
        return [] if waiting is None else [Frame(waiting.time_s, waiting.received_s, None, NO_REFERENCE)]

    def _with_tool(self, tool: Frame) -> list[Frame]:
        done = self.rest()
        if self._seen is not None and abs(self._seen.time_s - tool.time_s) <= SAME_S:
            return [*done, _composed(tool, self._seen)]
        self._waiting = tool
        return done

    def _with_reference(self, reference: Frame) -> list[Frame]:
        self._seen = reference
        if self._waiting is None or reference.time_s < self._waiting.time_s - SAME_S:
            return []
        if reference.time_s > self._waiting.time_s + SAME_S:
            return self.rest()
        tool, self._waiting = self._waiting, None
        return [_composed(tool, reference)]


def _same(asked: str, sent: str) -> bool:
    """Whether a name is the one asked for, perhaps cut to the bytes that a header holds."""
    return sent == asked or sent.encode() == asked.encode()[:NAME_BYTES]


def _composed(tool: Frame, reference: Frame) -> Frame:
    received_s = max(tool.received_s, reference.received_s)
    if tool.T is None:
        return Frame(tool.time_s, received_s, None, tool.fault)
    if reference.T is None:
        return Frame(tool.time_s, received_s, None, f"{NO_REFERENCE} ({reference.fault})")
    return Frame(tool.time_s, received_s, inverse(reference.T) @ tool.T)
