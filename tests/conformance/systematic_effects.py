"""Effects that a dropped datagram must not have (3.5), and answers left out, doubled or altered (4.9).

The causes are those that the page's table of checks names, the client's own left out.
"""

import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from protocol.datagram import decode, encode
from protocol.datagram_layout import HEADER_BYTES
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, Bye, HeartbeatReply, Message, State, Welcome
from protocol.server_session import ReferenceServer
from protocol.session_events import DatagramDropped, ServerEvent
from tests.conformance.mutator import KEY, BrokenController, hooked
from tests.support.paths import DOCS

_TABLE = re.compile(r"^\| .* \| (`[a-z_.]+`.*) \|$", re.MULTILINE)


def causes() -> tuple[str, ...]:
    """Every cause of the table of 3.5, in its order, each once."""
    text = (DOCS / "protocol.md").read_text()
    table = text[text.index("| check | cause |") :].split("\n\n")[0]
    named = [cause for row in _TABLE.findall(table) for cause in re.findall(r"`([a-z_.]+)`", row)]
    return tuple(dict.fromkeys(cause for cause in named if not cause.startswith("clock.")))


class _Affected(ReferenceServer):
    """A server on which a datagram that it drops for ``cause`` has an effect."""

    cause = ""
    effect: Callable[..., None]

    def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
        events = super().receive(data, source, now_ns)
        if any(isinstance(event, DatagramDropped) and event.cause == self.cause for event in events):
            self.effect(data, source, now_ns)
        return events

    def moves_the_number(self, data: bytes, source: object, now_ns: int) -> None:
        window = self._session.channel._window if self._session else None
        if window and len(data) >= HEADER_BYTES:
            window.newest = int.from_bytes(data[24:28], "little")

    def moves_the_age(self, data: bytes, source: object, now_ns: int) -> None:
        if self._session and len(data) >= HEADER_BYTES:
            self._session.channel._age.age_ns(int.from_bytes(data[32:40], "little"), now_ns)

    def is_a_sign_of_life(self, data: bytes, source: object, now_ns: int) -> None:
        if self._session:
            self._session.channel.heard_ns = now_ns

    def counts_as_lost(self, data: bytes, source: object, now_ns: int) -> None:
        self._tally.lost += 1

    def is_not_counted(self, data: bytes, source: object, now_ns: int) -> None:
        self._tally.refused -= 1

    def is_counted_twice(self, data: bytes, source: object, now_ns: int) -> None:
        self._tally.refused += 1

    def ends_the_session(self, data: bytes, source: object, now_ns: int) -> None:
        if self._session:
            self._close(Reason.SHUTDOWN, now_ns, tell_peer=False)

    def is_answered(self, data: bytes, source: object, now_ns: int) -> None:
        self._refused_at_ns = None
        self._refuse(Reason.UNKNOWN_SESSION, 0, source, now_ns)

    def begins_the_session_that_is_granted(self, data: bytes, source: object, now_ns: int) -> None:
        if self._unconfirmed:
            self._confirmed(now_ns)


EFFECTS = [name for name in vars(_Affected) if not name.startswith("_") and name not in ("cause", "receive")]
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
    "sends twice ACKNOWLEDGEMENT OVERTAKEN": 405,
}


def _drops() -> Iterator[BrokenController]:
    for cause in causes():
        key = KEY if cause.startswith("authentication.") and cause != "authentication.no_key" else None
        for effect in EFFECTS:
            members = {"cause": cause, "effect": getattr(_Affected, effect)}
            make = hooked(server_class=type("Affected", (_Affected,), members), link_key=key)
            name = f"{cause} {effect.replace('_', ' ')}"
            clause = "11.10" if key else "5.3" if cause == "datagram.stale" else "3.5"
            sound, meant = _AS_IT_SHALL_BE.get(name, ""), _MEANT.get(name, 0)
            yield BrokenController(name, clause, make, key, unseen=sound, case=meant)


REASONS = list(Reason)
# The answers that need no motion, with the clause that says when they are given.
ANSWERS: tuple[tuple[type, dict[Reason | None, str]], ...] = (
    (Acknowledgement, {
        Reason.ACCEPTED: "6.2", Reason.DISABLED: "7.3", Reason.NOT_IN_ERROR: "7.3",
        Reason.ERROR_LATCHED: "7.4", Reason.EMERGENCY_LATCHED: "7.4", Reason.ALREADY_DONE: "7.3",
        Reason.EMPTY_PATH: "3.6", Reason.TOO_MANY_WAYPOINTS: "3.6", Reason.UNKNOWN_COMMAND: "3.6",
        Reason.REPEATED_COMMAND_ID: "6.5",
        Reason.OVERTAKEN: "6.4", Reason.NOT_NEGOTIATED: "6.8",
    }),
    (Bye, {
        Reason.INCOMPATIBLE_VERSION: "4.4", Reason.WRONG_ARM: "4.1", Reason.SESSION_OCCUPIED: "4.5",
        Reason.UNKNOWN_SESSION: "4.4", Reason.LINK_TIMEOUT: "5.4",
    }),
    (Welcome, {None: "4.2"}), (HeartbeatReply, {None: "5.5"}), (State, {None: "7.7"}),
)  # fmt: skip


def _other_reason(step: int, message: Any) -> list[Message]:
    return [message._replace(reason=REASONS[(REASONS.index(message.reason) + step) % len(REASONS)])]


def _other_number(field: str, message: Any) -> list[Message]:
    return [message._replace(**{field: getattr(message, field) + 1.0})]


def _instead(kind: type, reason: Reason | None, instead: Callable[[Any], list[Message]]) -> Any:
    """The hook that sends something else in the place of one of its messages."""

    def outgoing(_: Any, data: bytes) -> list[bytes]:
        header, message = decode(data)
        concerned = isinstance(message, kind) and reason in (None, getattr(message, "reason", None))
        return [encode(each, header) for each in instead(message)] if concerned else [data]

    return outgoing


def _answers() -> Iterator[BrokenController]:
    for kind, clauses in ANSWERS:
        for reason, clause in clauses.items():
            ways: dict[str, Any] = {"leaves out": lambda _: [], "sends twice": lambda message: [message] * 2}
            if reason is not None:
                ways["sends the next reason for"] = partial(_other_reason, 1)
                ways["sends the reason before for"] = partial(_other_reason, -1)
            if kind is Acknowledgement:
                ways["sends another value in"] = partial(_other_number, "value")
                ways["sends another limit in"] = partial(_other_number, "limit")
            what = f"{kind.__name__.upper()} {reason.name}" if reason else kind.__name__
            for way, instead in ways.items():
                make = hooked(outgoing=_instead(kind, reason, instead))
                yield BrokenController(f"{way} {what}", clause, make, case=_MEANT.get(f"{way} {what}", 0))


MUTANTS = (*_drops(), *_answers())
