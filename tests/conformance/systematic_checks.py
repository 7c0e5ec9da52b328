# ruff: noqa: E501  (a row is read beside the line that it changes)
"""For every kind of datagram each check of a session left out, and the checks of HELLO one by one.

A check is left out where the code makes it: its condition does not hold for that kind.
"""

from collections.abc import Iterator

from protocol.datagram_layout import MESSAGE_TYPES, Kind
from tests.conformance.mutator import BrokenController, Edit, edited
from tests.conformance.systematic_fields import RECEIVED

_OF_A_SESSION = tuple(kind for kind in RECEIVED if kind is not Kind.HELLO)
_IN_ORDER = tuple(kind for kind in _OF_A_SESSION if kind is not Kind.BYE)
_ARRIVED = "if dropped is not None:\n            return [dropped]\n        events ="
# The check that is left out: the module, its condition and how it ends, for which kinds it can be, the clause.
CHECKS: dict[str, tuple[str, str, tuple[Kind, ...], str]] = {
    "magic": ("datagram", "if magic != MAGIC", RECEIVED, "3.5"),
    "major version": ("datagram", "if major != VERSION_MAJOR", RECEIVED, "3.5"),
    "CRC": (
        "datagram",
        "if checksum != crc32(datagram[_CRC_END:], crc32(datagram[:CRC_OFFSET]))",
        RECEIVED,
        "3.2",
    ),
    "critical flags": ("datagram", "if flags & CRITICAL_FLAGS & ~KNOWN_CRITICAL_FLAGS", RECEIVED, "3.4"),
    "session": ("server", "session = self._addressed(header.session)", _OF_A_SESSION, "3.5"),
    "source": ("server", "        if source != session.source", _OF_A_SESSION, "3.5"),
    "minor version": ("server", "if header.minor != session.channel.minor", _OF_A_SESSION, "3.5"),
    "late": ("server", "sequence.reordered sequence.old", _IN_ORDER, "5.2"),
    "leap": ("server", "sequence.jump", _IN_ORDER, "8"),
    "stale": ("server", "datagram.stale", _IN_ORDER, "5.3"),
    "duplicate": ("server", "sequence.duplicate", _IN_ORDER, "5.2"),
}
_LENGTH = "if payload_bytes != size - HEADER_BYTES - after_payload:"
_SIZE = "    if len(payload) != codec.layout.size:"
_RANGE = "            raise _bad_value(codec.kind, field.name, numbers[at])\n        at +="
_MEMBER = "                raise _bad_value(codec.kind, field.name, numbers[at])"
_PATH = '        raise _bad_value(Kind.REFERENCE_PATH, "command_id", command_id)'
_ARM = "if hello.arm_hash not in (ANY_ARM, self._arm_hash):"
HELLO_CHECKS: dict[str, tuple[str, str, str]] = {
    "the arm": (_ARM, "if False:", "4.1"),
    "the lower half of the arm": (_ARM, "if hello.arm_hash and hello.arm_hash >> 32 != self._arm_hash >> 32:", "4.1"),
    "the upper half of the arm": (_ARM, "if hello.arm_hash and (hello.arm_hash ^ self._arm_hash) & 0xFFFFFFFF:", "4.1"),
    "that it is of no session": ("if header.session != 0:", "if False:", "3.5"),
    "when it was sent": ("header.sent_ns < session.hello_sent_ns", "False", "4.5"),
    "that its nonce is new": (" or hello.client_nonce in self._past_nonces", "", "4.6"),
}  # fmt: skip
UNSEEN = {"leaves out, in HEARTBEAT, range of integers": "its time may be any number"}


def _without(check: str, module: str, condition: str, kind: Kind) -> Edit:
    if check == "session":
        used = (
            f"{condition} or (self._session if isinstance(message, {MESSAGE_TYPES[kind].__name__}) else None)"
        )
        return module, condition, used
    if module == "datagram":
        return module, condition, f"{condition} and kind != {int(kind)}"
    named = f"type(message).__name__ in ({MESSAGE_TYPES[kind].__name__!r}, {'UnusableRequest'!r})"
    if "if" not in condition:  # the causes of drops
        used = f"if dropped is not None and not (dropped.cause in {condition.split()} and {named}):\n"
        return module, _ARRIVED, used + _ARRIVED.split("\n", 1)[1]
    return module, condition, f"{condition} and not {named}"


def _of_length(kind: Kind) -> Iterator[tuple[str, tuple[Edit, ...]]]:
    """The payload may be too long, or too short."""
    longer = (
        (
            "datagram",
            _LENGTH,
            f"if payload_bytes != size - HEADER_BYTES - after_payload and kind != {int(kind)}:",
        ),
        (
            "datagram",
            _SIZE,
            f"    if kind == {int(kind)}:\n        payload = datagram[HEADER_BYTES:][:codec.layout.size]\n{_SIZE}",
        ),
    )
    shorter = (
        longer[0],
        (
            "datagram",
            _SIZE,
            f"    if kind == {int(kind)}:\n        payload = payload.ljust(codec.layout.size, b'\\0')\n{_SIZE}",
        ),
    )
    yield "payload too long", longer
    yield "payload too short", shorter


def _of_range(kind: Kind) -> tuple[Edit, ...]:
    """Integers out of their range, and unknown members of an enumeration, are taken."""
    if kind is Kind.REFERENCE_PATH:
        return (("datagram", _PATH, "        command_id = 1"),)
    sound = (
        f"values.append(min(max(numbers[at], field.low), field.highest)) if codec.kind == {int(kind)} else "
    )
    first = f"values.append(next(iter(field.enum))) if codec.kind == {int(kind)} else "
    failing = "(_ for _ in ()).throw(_bad_value(codec.kind, field.name, numbers[at]))"
    return (
        ("datagram", _RANGE, f"            {sound}{failing}\n        at +="),
        ("datagram", _MEMBER + "\n        elif", f"                {first}{failing}\n        elif"),
    )


def _rows() -> Iterator[BrokenController]:
    for check, (module, condition, kinds, clause) in CHECKS.items():
        for kind in kinds:
            edit = _without(check, module, condition, kind)
            yield BrokenController(f"leaves out, in {kind.name}, {check}", clause, edited(edit))
    for kind in RECEIVED:
        for check, edits in (*_of_length(kind), ("range of integers", _of_range(kind))):
            name = f"leaves out, in {kind.name}, {check}"
            yield BrokenController(name, "3.5", edited(*edits), unseen=UNSEEN.get(name, ""))
    for check, (old, new, clause) in HELLO_CHECKS.items():
        yield BrokenController(f"leaves out, in HELLO, {check}", clause, edited(("server", old, new)))


MUTANTS = tuple(_rows())
