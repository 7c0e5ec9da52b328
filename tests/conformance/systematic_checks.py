"""For every kind of datagram each check of a session left out, and the checks of HELLO one by one.

A check is left out by mending what it would find, before the controller looks: the rest goes on as ever.
"""

import struct
from collections.abc import Callable, Iterator
from functools import partial

from conformance.bytes_of import with_number
from protocol.channel import Arrival
from protocol.datagram_layout import HEADER, HEADER_BYTES, PAYLOADS, Kind, offsets, size_of
from protocol.reference_messages import ANY_ARM
from protocol.server_session import ReferenceServer
from protocol.session_events import ServerEvent
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutant_report import BrokenController
from tests.conformance.systematic_fields import RECEIVED, intact

AT = dict(zip((field.name for field in HEADER), offsets(HEADER), strict=True))
SEQUENCES = 1 << 32
LATE_AT_MOST = 1 << 31
# Mends a datagram: bytes and source.
Mend = Callable[["_Mending", bytes, object], tuple[bytes, object]]


def _read(data: bytes, name: str) -> int:
    field = next(field for field in HEADER if field.name == name)
    return int(struct.unpack_from("<" + field.code, data, AT[name])[0])


def _put(data: bytes, name: str, value: int) -> bytes:
    field = next(field for field in HEADER if field.name == name)
    return with_number(data, AT[name], field.code, value)


class _Mending(ControllerUnderTest):
    """Mends the datagrams of one kind before it looks at them."""

    def __init__(self, kind: Kind, mend: Mend) -> None:
        super().__init__()
        self._kind, self._mend = kind, mend
        self.sent_ns = self.came_ns = 0

    def heard(self, data: bytes, source: object) -> tuple[bytes, object] | None:
        concerned = len(data) >= HEADER_BYTES and data[AT["kind"]] == self._kind
        return self._mend(self, data, source) if concerned else (data, source)

    @property
    def newest(self) -> int:
        """The newest number of the open session."""
        session = self.server._session
        window = session.channel._window if session else None
        return window.newest if window else 0


def _session(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    number = server.server.session
    return (_put(data, "session", number), source) if number and intact(data) else (data, source)


def _source(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    session = server.server._session
    return data, session.source if session and intact(data) else source


def _minor(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    session = server.server._session
    return (
        (_put(data, "minor", session.channel.minor), source) if session and intact(data) else (data, source)
    )


def _late(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    return _renumbered(server, data, source, lambda ahead: ahead >= LATE_AT_MOST)


def _leaping(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    return _renumbered(server, data, source, lambda ahead: 65_536 < ahead < LATE_AT_MOST)


def _renumbered(
    server: _Mending, data: bytes, source: object, concerned: Callable[[int], bool]
) -> tuple[bytes, object]:
    ours = server.server.session and _read(data, "session") == server.server.session
    if not ours or not intact(data) or not concerned((_read(data, "sequence") - server.newest) % SEQUENCES):
        return data, source
    return _put(data, "sequence", (server.newest + 1) % SEQUENCES), source


def _stale(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    now_ns, sent_ns = server._clock_ns(), _read(data, "sent_ns")
    if not intact(data):
        return data, source
    elapsed = now_ns - server.came_ns
    if server.sent_ns and 0 < elapsed < 10**9:
        sent_ns = max(sent_ns, server.sent_ns + elapsed)
    server.sent_ns, server.came_ns = sent_ns, now_ns
    return _put(data, "sent_ns", sent_ns), source


def _critical(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    return (_put(data, "flags", _read(data, "flags") & 0xFF), source) if _sealed(data) else (data, source)


def _major(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    return (_put(data, "major", 1), source) if _sealed(data) else (data, source)


def _magic(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    return (with_number(b"LRLK" + data[4:], 5, "B", data[5]), source) if _sealed(data) else (data, source)


def _crc(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    return with_number(data, 7, "B", data[7]), source


def _longer(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    wanted = size_of(PAYLOADS[server._kind])
    if not _sealed(data) or len(data) <= HEADER_BYTES + wanted:
        return data, source
    return _put(data[: HEADER_BYTES + wanted], "payload_bytes", wanted), source


def _shorter(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    wanted = size_of(PAYLOADS[server._kind])
    if not _sealed(data) or len(data) >= HEADER_BYTES + wanted:
        return data, source
    return _put(data.ljust(HEADER_BYTES + wanted, b"\0"), "payload_bytes", wanted), source


def _values(server: _Mending, data: bytes, source: object) -> tuple[bytes, object]:
    """Integers outside their range become the end of it, unknown members of an enumeration the first."""
    if not intact(data):
        return data, source
    fields = PAYLOADS[server._kind]
    for field, offset in zip(fields, offsets(fields), strict=True):
        if field.code not in "BHIQ" or field.name in ("code", "waypoint_count"):
            continue
        at = HEADER_BYTES + offset
        value = struct.unpack_from("<" + field.code, data, at)[0]
        low, high = field.low, field.highest
        known = value in [member.value for member in field.enum] if field.enum else low <= value <= high
        if not known:
            sound = next(iter(field.enum)).value if field.enum else min(max(value, low), high)
            data = with_number(data, at, field.code, sound)
    return data, source


def _sealed(data: bytes) -> bool:
    return len(data) >= HEADER_BYTES and data == with_number(data, 7, "B", data[7])


# The check that is left out: for which kinds it can be, and the clause.
_OF_A_SESSION = tuple(kind for kind in RECEIVED if kind is not Kind.HELLO)
_IN_ORDER = tuple(kind for kind in _OF_A_SESSION if kind is not Kind.BYE)
CHECKS: dict[str, tuple[Mend, tuple[Kind, ...], str]] = {
    "magic": (_magic, RECEIVED, "3.5"),
    "major version": (_major, RECEIVED, "3.5"),
    "CRC": (_crc, RECEIVED, "3.2"),
    "critical flags": (_critical, RECEIVED, "3.4"),
    "payload too long": (_longer, RECEIVED, "3.5"),
    "payload too short": (_shorter, RECEIVED, "3.5"),
    "range of integers": (_values, RECEIVED, "3.5"),
    "session": (_session, _OF_A_SESSION, "3.5"),
    "source": (_source, _OF_A_SESSION, "3.5"),
    "minor version": (_minor, _OF_A_SESSION, "3.5"),
    "late": (_late, _IN_ORDER, "5.2"),
    "leap": (_leaping, _IN_ORDER, "8"),
    "stale": (_stale, _IN_ORDER, "5.3"),
}


class _Forgetful(ReferenceServer):
    """Takes datagrams of one kind for new ones that it has had before."""

    kind = Kind.COMMAND

    def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
        window = self._session.channel._window if self._session else None
        if window is None or len(data) < HEADER_BYTES or data[AT["kind"]] != self.kind:
            return super().receive(data, source, now_ns)
        arrive = window.arrive

        def forgetting(sequence: int) -> tuple[Arrival, int]:
            arrival, skipped = arrive(sequence)
            return (Arrival.NEW if arrival is Arrival.DUPLICATE else arrival), skipped

        window.arrive = forgetting  # type: ignore[method-assign]
        try:
            return super().receive(data, source, now_ns)
        finally:
            del window.arrive


class _Repeating(ControllerUnderTest):
    """Uses datagrams of one kind as often as they come."""

    def __init__(self, kind: Kind) -> None:
        self.server_class = type("Forgetful", (_Forgetful,), {"kind": kind})
        super().__init__()


class _MendingHello(_Mending):
    """Mends one number of HELLO."""

    def __init__(self, mend: Callable[["_MendingHello", bytes], bytes]) -> None:
        super().__init__(
            Kind.HELLO, lambda _, data, source: (mend(self, data) if intact(data) else data, source)
        )


def _any_arm(server: _MendingHello, data: bytes) -> bytes:
    return with_number(data, HEADER_BYTES + 16, "Q", ANY_ARM)


def _half_an_arm(low: int, server: _MendingHello, data: bytes) -> bytes:
    """The half of the hash that begins at bit ``low`` is not compared."""
    asked, own = struct.unpack_from("<Q", data, HEADER_BYTES + 16)[0], server.arm_hash()
    mask = 0xFFFFFFFF << low
    return with_number(data, HEADER_BYTES + 16, "Q", (asked & ~mask) | (own & mask)) if asked else data


def _without_session(server: _MendingHello, data: bytes) -> bytes:
    return _put(data, "session", 0)


def _sent_now(server: _MendingHello, data: bytes) -> bytes:
    session = server.server._session
    return _put(data, "sent_ns", max(_read(data, "sent_ns"), session.hello_sent_ns)) if session else data


def _new_nonce(server: _MendingHello, data: bytes) -> bytes:
    server.server._past_nonces.clear()
    return data


HELLO_CHECKS: dict[str, tuple[Callable[[_MendingHello, bytes], bytes], str]] = {
    "the arm": (_any_arm, "4.1"),
    "the lower half of the arm": (partial(_half_an_arm, 0), "4.1"),
    "the upper half of the arm": (partial(_half_an_arm, 32), "4.1"),
    "that it is of no session": (_without_session, "3.5"),
    "when it was sent": (_sent_now, "4.5"),
    "that its nonce is new": (_new_nonce, "4.6"),
}
UNSEEN = {
    "leaves out, in HEARTBEAT, range of integers": "its time may be any number",
}


def _rows() -> Iterator[BrokenController]:
    for check, (mend, kinds, clause) in CHECKS.items():
        for kind in kinds:
            name = f"leaves out, in {kind.name}, {check}"
            yield BrokenController(name, clause, partial(_Mending, kind, mend), unseen=UNSEEN.get(name, ""))
    for kind in _IN_ORDER:
        yield BrokenController(f"leaves out, in {kind.name}, duplicate", "5.2", partial(_Repeating, kind))
    for check, (mend_hello, clause) in HELLO_CHECKS.items():
        name = f"leaves out, in HELLO, {check}"
        yield BrokenController(name, clause, partial(_MendingHello, mend_hello))


MUTANTS = tuple(_rows())
