"""The plant's clock on the wire: the plant ticks, every part answers. Source: docs/plant_clock.md.

One TCP connection a part. Messages of MESSAGE_BYTES bytes, little endian, both ways.
"""

import struct
from enum import IntEnum
from typing import NamedTuple

from protocol.errors import LinkLost

MAGIC = b"LRC1"
START_NS = 3_600_000_000_000
"""The first time of a clock that nobody has followed before: no age that is measured from it is negative."""
PICTURE, IN_VAIN, SENT = 1, 2, 4
"""Flags of TICK: a picture was published for this time; what was asked of the plant stays unanswered.
Of DONE: something was sent to another part, which is to act on it at the next tick.
"""

_LAYOUT = struct.Struct("<4sBBHIQQ16s")
MESSAGE_BYTES = _LAYOUT.size
_NAME_BYTES = 16


class TickKind(IntEnum):
    """JOIN, READY, DONE, HELD go to the plant; TIME, TICK, STANDS come from it."""

    JOIN = 1
    READY = 2
    DONE = 3
    HELD = 4
    TIME = 5
    TICK = 6
    STANDS = 7


class ClockMessage(NamedTuple):
    """``number``: of the tick. ``time_ns``: what time it is; in JOIN, what time it is for the part; in DONE,
    when the part has something to do next by itself, 0 at the next tick.

    ``value``: in JOIN the period (ns) that the part asks for, 0 where it has none; in TIME and TICK the pace
    of the last second, a millionth of real time. ``name``: of the part, in STANDS of who is waited for.
    """

    kind: TickKind
    number: int = 0
    time_ns: int = 0
    value: int = 0
    flags: int = 0
    name: str = ""


def encode(message: ClockMessage) -> bytes:
    """The MESSAGE_BYTES bytes of ``message``; a longer name is cut."""
    kind, number, time_ns, value, flags, name = message
    return _LAYOUT.pack(MAGIC, kind, flags, 0, number, time_ns, value, name.encode()[:_NAME_BYTES])


def decode(data: bytes) -> tuple[list[ClockMessage], bytes]:
    """The whole messages in ``data``, and what is left of it.

    Raises LinkLost (``link.clock_place``) for what is none: the connection has lost its place.
    """
    whole = len(data) // MESSAGE_BYTES * MESSAGE_BYTES
    return [_message(*fields) for fields in _LAYOUT.iter_unpack(data[:whole])], data[whole:]


def _message(
    magic: bytes, kind: int, flags: int, _reserved: int, number: int, time_ns: int, value: int, name: bytes
) -> ClockMessage:
    try:
        known = TickKind(kind)
        words = name.rstrip(b"\0").decode("ascii")
    except ValueError as error:
        raise LinkLost("link.clock_place", f"a message of the plant's clock: {error}") from error
    if magic != MAGIC:
        raise LinkLost("link.clock_place", f"magic {magic.hex()}: wanted {MAGIC.hex()}")
    return ClockMessage(known, number, time_ns, value, flags, words)
