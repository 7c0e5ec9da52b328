"""Exactly-once execution: which requests of a session wait, which were seen, how each was answered."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import NamedTuple

from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, Request, is_stop, overtaken

REMEMBERED = 256


class Verdict(NamedTuple):
    """``execute``: hand the request on. ``answer``: send this now. Neither: its answer is still to come."""

    execute: bool
    answer: Acknowledgement | None


class _Answered(NamedTuple):
    content: bytes
    acknowledgement: Acknowledgement


class CommandLedger:
    """Ids rise within a session, and an id is executed only if it is above all before it.

    So a request that was lost and is sent again after a later one was executed is not executed any more: a
    motion cannot overtake the stop that was meant to end it. The newest 256 answers are kept for repetition.
    """

    def __init__(self) -> None:
        self._newest_id = 0
        self._pending: dict[int, bytes] = {}
        self._answered: OrderedDict[int, _Answered] = OrderedDict()

    def admit(self, command_id: int, content: bytes) -> Verdict:
        """What to do with a request; ``content``, what it asks for, tells a repetition from another one."""
        if command_id in self._pending:
            if self._pending[command_id] == content:
                return Verdict(False, None)
            return Verdict(False, Acknowledgement(command_id, Reason.REPEATED_COMMAND_ID, 0.0, 0.0))
        answered = self._answered.get(command_id)
        if answered is not None:
            if answered.content == content:
                return Verdict(False, answered.acknowledgement)
            return Verdict(False, Acknowledgement(command_id, Reason.REPEATED_COMMAND_ID, 0.0, 0.0))
        if command_id <= self._newest_id:
            return Verdict(False, overtaken(command_id, self._newest_id))
        self._newest_id = command_id
        self._pending[command_id] = content
        return Verdict(True, None)

    def settle(self, acknowledgement: Acknowledgement) -> bool:
        """Whether ``acknowledgement`` answers a pending request; it is kept for repetition."""
        content = self._pending.pop(acknowledgement.command_id, None)
        if content is None:
            return False
        self._answered[acknowledgement.command_id] = _Answered(content, acknowledgement)
        while len(self._answered) > REMEMBERED:
            self._answered.popitem(last=False)
        return True


# Ids of two runs of a client must differ: the controller's STATE may still name a motion of the run before.
# 21 bits of the nonce above a 32-bit count keep the id below 2^53, where every JSON reader holds it exactly.
_RUN_BITS = 21
_COUNT_BITS = 32


@dataclass(slots=True)
class _Open:
    request: Request
    sent_ns: int


class OpenRequests:
    """Requests of one run of a client, whose ``nonce`` keeps its ids apart from those of other runs."""

    def __init__(self, nonce: int) -> None:
        self._next_id: int = ((nonce % 2**_RUN_BITS) << _COUNT_BITS) + 1
        self._open: dict[int, _Open] = {}

    def numbered(self, request: Request) -> Request:
        """``request`` under the next id, which is used up only by ``enter``."""
        return request._replace(command_id=self._next_id)

    def enter(self, request: Request, now_ns: int) -> None:
        """Notes that a numbered request was sent."""
        self._next_id = max(self._next_id, request.command_id + 1)
        self._open[request.command_id] = _Open(request, now_ns)

    @property
    def next_id(self) -> int:
        """The id of the next request."""
        return self._next_id

    def settle(self, command_id: int) -> bool:
        """Whether the answer to ``command_id`` was waited for; it is not any more."""
        return self._open.pop(command_id, None) is not None

    def give_up(self) -> tuple[int, ...]:
        """The ids that were not answered; nothing is waited for any more."""
        ids = tuple(self._open)
        self._open.clear()
        return ids

    def due(self, now_ns: int, resend_ns: int) -> list[Request]:
        """The requests to be sent again now, stops first: those last sent ``resend_ns`` ago or earlier."""
        late = [each for each in self._open.values() if now_ns - each.sent_ns >= resend_ns]
        for each in late:
            each.sent_ns = now_ns
        return sorted((each.request for each in late), key=lambda request: not is_stop(request))

    def due_ns(self, resend_ns: int) -> list[int]:
        """When each of them is due again."""
        return [each.sent_ns + resend_ns for each in self._open.values()]
