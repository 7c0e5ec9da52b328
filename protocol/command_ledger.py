"""Exactly-once execution: which requests of a session were seen, and how each was answered."""

from collections import OrderedDict
from typing import NamedTuple

from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, overtaken

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
