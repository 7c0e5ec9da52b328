"""Every answer left out, sent twice, or with another reason: each row of 4.9 that sends something."""

from collections.abc import Callable, Iterator
from functools import partial

from protocol.datagram import decode, encode
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, Bye, HeartbeatReply, Message, State, Welcome
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutant_report import BrokenController

REASONS = list(Reason)
# The reasons that need no motion, with the clause that says when they are given.
OF_REQUESTS = {
    Reason.ACCEPTED: "6.2",
    Reason.DISABLED: "7.3",
    Reason.NOT_IN_ERROR: "7.3",
    Reason.ERROR_LATCHED: "7.4",
    Reason.EMERGENCY_LATCHED: "7.4",
    Reason.ALREADY_DONE: "7.3",
    Reason.EMPTY_PATH: "3.6",
    Reason.TOO_MANY_WAYPOINTS: "3.6",
    Reason.UNKNOWN_COMMAND: "3.6",
    Reason.REPEATED_COMMAND_ID: "6.5",
    Reason.OVERTAKEN: "6.4",
    Reason.NOT_NEGOTIATED: "6.8",
}
OF_BYES = {
    Reason.INCOMPATIBLE_VERSION: "4.4",
    Reason.WRONG_ARM: "4.1",
    Reason.SESSION_OCCUPIED: "4.5",
    Reason.UNKNOWN_SESSION: "4.4",
    Reason.LINK_TIMEOUT: "5.4",
}
OF_KINDS: dict[type, str] = {Welcome: "4.2", HeartbeatReply: "5.5", State: "7.7"}


class _Answering(ControllerUnderTest):
    """Sends something else in the place of one of its messages."""

    def __init__(
        self, concerned: Callable[[Message], bool], instead: Callable[[Message], list[Message]]
    ) -> None:
        super().__init__()
        self._concerned, self._instead = concerned, instead

    def outgoing(self, data: bytes) -> list[bytes]:
        header, message = decode(data)
        if not self._concerned(message):  # type: ignore[arg-type]
            return [data]
        return [encode(each, header) for each in self._instead(message)]  # type: ignore[arg-type]


def _is(kind: type, reason: Reason | None, message: Message) -> bool:
    return isinstance(message, kind) and (reason is None or getattr(message, "reason", None) is reason)


def _nothing(message: Message) -> list[Message]:
    return []


def _twice(message: Message) -> list[Message]:
    return [message, message]


def _next_reason(step: int, message: Message) -> list[Message]:
    assert isinstance(message, Acknowledgement | Bye)
    other = REASONS[(REASONS.index(message.reason) + step) % len(REASONS)]
    return [message._replace(reason=other)]


def _with_numbers(value: float, limit: float, message: Message) -> list[Message]:
    assert isinstance(message, Acknowledgement)
    return [message._replace(value=message.value + value, limit=message.limit + limit)]


def _rows() -> Iterator[BrokenController]:
    whats: list[tuple[str, type, Reason | None, str]] = [
        *((f"ACKNOWLEDGEMENT {r.name}", Acknowledgement, r, clause) for r, clause in OF_REQUESTS.items()),
        *((f"BYE {r.name}", Bye, r, clause) for r, clause in OF_BYES.items()),
        *((kind.__name__, kind, None, clause) for kind, clause in OF_KINDS.items()),
    ]
    for what, kind, reason, clause in whats:
        ways: dict[str, Callable[[Message], list[Message]]] = {"leaves out": _nothing, "sends twice": _twice}
        if reason is not None:
            ways["sends the next reason for"] = partial(_next_reason, 1)
            ways["sends the reason before for"] = partial(_next_reason, -1)
        if kind is Acknowledgement:
            ways["sends another value in"] = partial(_with_numbers, 1.0, 0.0)
            ways["sends another limit in"] = partial(_with_numbers, 0.0, 1.0)
        for way, instead in ways.items():
            make = partial(_Answering, partial(_is, kind, reason), instead)
            name = f"{way} {what}"
            meant = 405 if name == "sends twice ACKNOWLEDGEMENT OVERTAKEN" else 0
            yield BrokenController(name, clause, make, case=meant)


MUTANTS = tuple(_rows())
