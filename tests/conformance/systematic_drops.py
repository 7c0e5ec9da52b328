"""For every cause for which a datagram is dropped (3.5), every effect that it must not have.

The causes are those that the page's table of checks names, the client's own left out.
"""

import re
from collections.abc import Callable, Iterator
from functools import partial

from protocol.authentication import LinkKey
from protocol.datagram_layout import HEADER_BYTES
from protocol.faults import Reason
from protocol.server_session import ReferenceServer
from protocol.session_events import DatagramDropped, ServerEvent
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutant_report import BrokenController
from tests.conformance.mutants.key import KEY
from tests.support.paths import DOCS

_TABLE = re.compile(r"^\| .* \| (`[a-z_.]+`.*) \|$", re.MULTILINE)
# The server, the datagram, its source, and now.
Effect = Callable[["_Affected", bytes, object, int], None]


def causes() -> tuple[str, ...]:
    """Every cause of the table of 3.5, in its order, each once."""
    text = (DOCS / "protocol.md").read_text()
    table = text[text.index("| check | cause |") :].split("\n\n")[0]
    named = [cause for row in _TABLE.findall(table) for cause in re.findall(r"`([a-z_.]+)`", row)]
    return tuple(dict.fromkeys(cause for cause in named if not cause.startswith("clock.")))


class _Affected(ReferenceServer):
    """A server on which a datagram that it drops for ``cause`` has an effect."""

    cause = ""
    effect: Effect

    def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
        events = super().receive(data, source, now_ns)
        if any(isinstance(event, DatagramDropped) and event.cause == self.cause for event in events):
            type(self).effect(self, data, source, now_ns)
        return events


def _number(data: bytes) -> int:
    return int.from_bytes(data[24:28], "little")


def _moves_the_number(server: _Affected, data: bytes, source: object, now_ns: int) -> None:
    window = server._session.channel._window if server._session else None
    if window and len(data) >= HEADER_BYTES:
        window.newest = _number(data)


def _moves_the_age(server: _Affected, data: bytes, source: object, now_ns: int) -> None:
    if server._session and len(data) >= HEADER_BYTES:
        server._session.channel._age.age_ns(int.from_bytes(data[32:40], "little"), now_ns)


def _is_life(server: _Affected, data: bytes, source: object, now_ns: int) -> None:
    if server._session:
        server._session.channel.heard_ns = now_ns


def _is_a_loss(server: _Affected, data: bytes, source: object, now_ns: int) -> None:
    server._tally.lost += 1


def _is_not_counted(server: _Affected, data: bytes, source: object, now_ns: int) -> None:
    server._tally.refused -= 1


def _is_counted_twice(server: _Affected, data: bytes, source: object, now_ns: int) -> None:
    server._tally.refused += 1


def _ends_the_session(server: _Affected, data: bytes, source: object, now_ns: int) -> None:
    if server._session:
        server._closed(Reason.SHUTDOWN, now_ns, tell_peer=False)


def _is_answered(server: _Affected, data: bytes, source: object, now_ns: int) -> None:
    server._refused_at_ns = None
    server._refuse(Reason.UNKNOWN_SESSION, 0, source, now_ns)


def _begins_the_grant(server: _Affected, data: bytes, source: object, now_ns: int) -> None:
    if server._unconfirmed:
        server._confirmed(now_ns)


EFFECTS: dict[str, Effect] = {
    "moves the number": _moves_the_number,
    "moves the age": _moves_the_age,
    "is a sign of life": _is_life,
    "counts as lost": _is_a_loss,
    "is not counted": _is_not_counted,
    "is counted twice": _is_counted_twice,
    "ends the session": _ends_the_session,
    "is answered": _is_answered,
    "begins the session that is granted": _begins_the_grant,
}
# What is no effect: these are sound.
_AS_IT_SHALL_BE = {
    "datagram.too_short moves the number": "there is no number in it",
    "datagram.too_short moves the age": "there is no time in it",
    "datagram.stale moves the number": "it came in order: it does move the number",
    "datagram.stale moves the age": "it came in order: its transit counts",
}
# The case that is meant to catch it, where those of its clause do not.
_MEANT = {
    "sequence.reordered is a sign of life": 253,
    "datagram.stale is answered": 329,
    "datagram.stale begins the session that is granted": 329,
}


class _Controller(ControllerUnderTest):
    """Has a server of any class."""

    def __init__(self, server: type[ReferenceServer], key: LinkKey | None) -> None:
        self.server_class, self.link_key = server, key
        super().__init__()


def _rows() -> Iterator[BrokenController]:
    for cause in causes():
        family = cause.partition(".")[0]
        key = KEY if family == "authentication" and cause != "authentication.no_key" else None
        for name, effect in EFFECTS.items():
            server = type("Affected", (_Affected,), {"cause": cause, "effect": staticmethod(effect)})
            make = partial(_Controller, server, key)
            name = f"{cause} {name}"
            clause = "11.10" if key else "5.3" if cause == "datagram.stale" else "3.5"
            sound, meant = _AS_IT_SHALL_BE.get(name, ""), _MEANT.get(name, 0)
            yield BrokenController(name, clause, make, key, unseen=sound, case=meant)


MUTANTS = tuple(_rows())
