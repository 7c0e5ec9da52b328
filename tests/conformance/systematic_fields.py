"""Every field of every message spoiled: made from the layouts of ``protocol.datagram_layout``.

What the controller sends: each field zero, one too high, one too low, as it was in the datagram before, and
changed with its neighbour; padding not zero. What it receives: each field misread in the same ways, and
padding demanded to be zero.
"""

import struct
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

from conformance.wire import resealed
from protocol.datagram_layout import (
    FLAG_AUTHENTICATED,
    HEADER,
    HEADER_BYTES,
    PAYLOADS,
    Field,
    Kind,
    offsets,
    size_of,
)
from tests.conformance.mutator import BrokenController, Make, hooked

KIND_AT, FLAGS_AT = 6, 8
SENT = (Kind.WELCOME, Kind.HEARTBEAT_REPLY, Kind.ACKNOWLEDGEMENT, Kind.STATE, Kind.BYE, Kind.STREAM_REFUSED)
RECEIVED = (
    Kind.HELLO, Kind.HEARTBEAT, Kind.REFERENCE_POSE, Kind.REFERENCE_PATH, Kind.COMMAND, Kind.BYE,
    Kind.STREAMED_POSE,
)  # fmt: skip
# The clause that says what a message's fields mean; some fields have one of their own.
OF_KIND = {
    Kind.HELLO: "4.1", Kind.WELCOME: "4.2", Kind.HEARTBEAT: "5.5", Kind.HEARTBEAT_REPLY: "5.5",
    Kind.REFERENCE_POSE: "6.7", Kind.REFERENCE_PATH: "6.8", Kind.COMMAND: "6.1", Kind.ACKNOWLEDGEMENT: "6.11",
    Kind.STATE: "7.7", Kind.BYE: "4.4", Kind.STREAMED_POSE: "12.7", Kind.STREAM_REFUSED: "12.4",
}  # fmt: skip
OF_FIELD = {
    "minor": "4.2", "session": "4.2", "sequence": "5.1", "echo_sequence": "5.7", "sent_ns": "1.7",
    "magic": "3.1", "major": "3.1", "kind": "3.5", "spare": "1.8", "flags": "3.4", "payload_bytes": "3.1",
    "padding": "1.8", "command_id": "6.1", "motion_done": "7.7", "fault": "7.7", "severity": "7.7",
    "number": "12.5", "stream_number": "12.3", "references_lost": "5.2",
}  # fmt: skip


class Place(NamedTuple):
    """One field: of a message of ``kind``, or with None of the header of all of them."""

    kind: Kind | None
    field: Field
    offset: int

    @property
    def name(self) -> str:
        """Such as ``STATE.time_ns``."""
        return f"{self.kind.name if self.kind else 'header'}.{self.field.name}"

    @property
    def clause(self) -> str:
        """The clause that is broken when it is spoiled."""
        own = OF_FIELD.get(self.field.name)
        return own or (OF_KIND[self.kind] if self.kind else "3.1")

    def of(self, data: bytes) -> bytes:
        """Its bytes."""
        return data[self.offset : self.offset + self.field.size]

    def put(self, data: bytes, value: bytes) -> bytes:
        """``data`` with other bytes in it."""
        return data[: self.offset] + value + data[self.offset + self.field.size :]


# From a datagram, its field, the same field of the datagram before, and its neighbour: another datagram.
Spoil = Callable[[bytes, Place, bytes, Place], bytes]


def places(kinds: tuple[Kind, ...]) -> Iterator[tuple[Place, Place]]:
    """Every field of the header and of these messages, each with its neighbour."""
    for kind in (None, *kinds):
        fields, start = (PAYLOADS[kind], HEADER_BYTES) if kind else (HEADER, 0)
        row = [Place(kind, f, start + at) for f, at in zip(fields, offsets(fields), strict=True)]
        for i, place in enumerate(row):
            alike = [each for each in row[i + 1 :] + row[:i] if _alike(each.field, place.field)]
            yield place, alike[0] if alike else place


def _alike(a: Field, b: Field) -> bool:
    return (a.code, a.count) == (b.code, b.count)


def _numbers(place: Place, data: bytes) -> list[float]:
    return list(struct.unpack(f"<{place.field.count}{place.field.code}", place.of(data)))


def _zero(data: bytes, place: Place, before: bytes, other: Place) -> bytes:
    return place.put(data, bytes(place.field.size))


def _stale(data: bytes, place: Place, before: bytes, other: Place) -> bytes:
    return place.put(data, before)


def _exchanged(data: bytes, place: Place, before: bytes, other: Place) -> bytes:
    return other.put(place.put(data, other.of(data)), place.of(data))


# How far off a field is: by what matters in its unit.
_STEPS = {"ns": 5_000_000, "ms": 100}


def _off(sign: int, data: bytes, place: Place, before: bytes, other: Place) -> bytes:
    """A step more or less; a real number by a hundredth, the first of several."""
    first, *others = _numbers(place, data)
    code = place.field.code
    if code == "d":
        first += sign / 100
    else:
        step = sign * _STEPS.get(place.field.unit, 1)
        first = (int(first) + step) % 2 ** (8 * struct.calcsize(code))
    return place.put(data, struct.pack(f"<{place.field.count}{code}", first, *others))


def _mixed_up(data: bytes, place: Place, before: bytes, other: Place) -> bytes:
    """The first two of several numbers changed with one another."""
    first, second, *others = _numbers(place, data)
    return place.put(data, struct.pack(f"<{place.field.count}{place.field.code}", second, first, *others))


def _dirty(data: bytes, place: Place, before: bytes, other: Place) -> bytes:
    return place.put(data, b"\xa5" * place.field.size)


def spoils(place: Place, other: Place) -> Iterator[tuple[str, Spoil]]:
    """What can be wrong with a field."""
    if place.field.name in ("padding", "spare"):
        yield "not zero", _dirty
        return
    yield "zero", _zero
    if place.field.code == "4s":
        return
    yield "as before", _stale
    yield "too high", partial(_off, 1)
    yield "too low", partial(_off, -1)
    if other is not place:
        yield f"for {other.field.name}", _exchanged
    if place.field.count > 1:
        yield "mixed up", _mixed_up


def _spoiling(place: Place, other: Place, spoil: Spoil, *, sends: bool) -> Make:
    """Makes controllers that spoil one field of what they send or of what they receive."""

    def spoiled(self: Any, data: bytes) -> bytes:
        if place.kind not in (None, data[KIND_AT]):
            return data
        value = place.of(data)
        before, self.before = self.before or value, value
        return resealed(spoil(data, place, before, other))

    if sends:
        return hooked(before=None, outgoing=lambda self, data: [spoiled(self, data)])
    return hooked(before=None, incoming=lambda self, data: spoiled(self, data) if intact(data) else data)


def _wants_zero(place: Place) -> Make:
    """Makes controllers that drop a datagram whose padding is not zero."""

    def incoming(_: Any, data: bytes) -> bytes | None:
        concerned = intact(data) and place.kind in (None, data[KIND_AT])
        return None if concerned and any(place.of(data)) else data

    return hooked(incoming=incoming)


def intact(data: bytes) -> bool:
    """Whether ``data`` is as long as its kind says, and its CRC right."""
    if len(data) < HEADER_BYTES or data != resealed(data):
        return False
    signed = struct.unpack_from("<H", data, FLAGS_AT)[0] & FLAG_AUTHENTICATED
    fields = PAYLOADS.get(data[KIND_AT]) if data[KIND_AT] in list(Kind) else None
    return not signed and fields is not None and len(data) == HEADER_BYTES + size_of(fields)


def _rows() -> Iterator[BrokenController]:
    for sends, kinds in ((True, SENT), (False, RECEIVED)):
        verb = "sends" if sends else "reads"
        for place, other in places(kinds):
            if place.field.name == "crc32":
                continue  # made right again behind every spoiled field
            if not sends and place.field.name in ("padding", "spare"):
                yield BrokenController(f"wants {place.name} zero", "1.8", _wants_zero(place))
                continue
            for how, spoil in spoils(place, other):
                name = f"{verb} {place.name} {how}"
                make = _spoiling(place, other, spoil, sends=sends)
                meant, unseen = MEANT.get(name, 0), UNSEEN.get(name, "")
                yield BrokenController(name, place.clause, make, unseen=unseen, case=meant)


_NEVER_CHANGES = "it is the same in every datagram"
_ITS_OWN = "nobody but the controller knows it"
_ANY_START = "it counts from any start"
# The case that is meant to catch it, where those of its clause do not.
MEANT: dict[str, int] = {
    "reads header.flags too high": 117,
    "sends STATE.cycle as before": 590,
    "sends STATE.severity as before": 591,
    "sends STATE.references_lost as before": 591,
    "sends STATE.references_dropped as before": 591,
    "sends STATE.motion_id as before": 592,
    "sends STATE.q_meas as before": 592,
    "sends STATE.q_cmd as before": 592,
    "sends STATE.segment as before": 593,
    "sends STATE.stream_number as before": 594,
    "sends STATE.valves mixed up": 595,
    "reads STREAMED_POSE.twist_ref mixed up": 578,
    "reads STREAMED_POSE.time_ns too high": 584,
    "reads STREAMED_POSE.time_ns too low": 584,
    "reads header.sent_ns too high": 584,
    "reads header.sent_ns too low": 584,
}
# What cannot be, as zero: 512 asks for an order of the latenesses, and for a pressure.
_IN_ORDER = {(field, "zero") for field in ("supply_bar", "lateness_p99_us", "lateness_max_us")}
UNSEEN: dict[str, str] = {
    "sends header.major as before": _NEVER_CHANGES,
    "sends header.minor zero": "the only minor version is 0",
    "sends header.minor as before": "the only minor version is 0",
    "sends header.flags zero": "the echo is optional",
    "sends header.flags as before": "the echo is optional",
    "sends WELCOME.arm_hash zero": "so does a controller whose arm has the hash 0",
    "sends WELCOME.arm_hash as before": _NEVER_CHANGES,
    "sends WELCOME.boot_id as before": _NEVER_CHANGES,
    "sends WELCOME.boot_id too high": _ITS_OWN + ", unless there is a key",
    "sends WELCOME.boot_id too low": _ITS_OWN + ", unless there is a key",
    "sends WELCOME.cycle_ns as before": _NEVER_CHANGES,
    "sends WELCOME.link_timeout_ms as before": _NEVER_CHANGES,
    **{
        f"sends STATE.{count} {how}": _ANY_START
        for count in ("cycle", "references_lost", "references_dropped")
        for how in ("too high", "too low")
    },
    "reads BYE.reason too high": "a controller does the same for every reason",
    "reads BYE.reason too low": "a controller does the same for every reason",
    **{
        f"reads header.echo_sequence {how}": "nothing depends on it (5.7)"
        for how in ("zero", "as before", "too high", "too low", "for crc32")
    },
    **{
        f"sends STATE.{field} {how}": _ITS_OWN
        for field in ("supply_bar", "overruns", "lateness_p50_us", "lateness_p99_us", "lateness_max_us",
                      "plant_exchange_failures")
        for how in ("zero", "as before", "too high", "too low")
        if (field, how) not in _IN_ORDER
    },
    "sends STATE.overruns for lateness_p50_us": _ITS_OWN,
}  # fmt: skip
MUTANTS = tuple(_rows())
