"""For every cell of table 7.3 a controller that answers otherwise, and one that goes elsewhere.

They are otherwise sound: the table of the scan differs in that cell alone.
"""

from collections.abc import Iterator
from functools import partial

from conformance.reference.arm.transitions import number_of
from controller.core.group_states import TRANSITIONS, Stimulus
from controller.core.requests import enter_mode
from protocol.axes_group import ANSWERS, Asked, Mode, Transition
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, ReferencePose, Request, StreamRefused
from protocol.session_events import StreamedPoseReceived
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutant_report import BrokenController

# Where a request leads that is taken for one that acts. What leads to a motion without a way ends in the
# same scan and cannot be told, so these drop the enable instead.
_ELSEWHERE = {
    Asked.ENABLE: Mode.STANDBY,
    Asked.DISABLE: Mode.DISABLED,
    Asked.STOP: Mode.DISABLED,
    Asked.RESET: Mode.DISABLED,
    Asked.EMERGENCY_STOP: Mode.ERROR_HELD,
    Asked.EMERGENCY_RELEASE: Mode.ERROR_HELD,
    Asked.START_STREAM: Mode.STREAMING,
    Asked.END_STREAM: Mode.DISABLED,
    Asked.MOVE: Mode.DISABLED,
    Asked.STREAMED: Mode.DISABLED,
}


class OfAnotherTable(ControllerUnderTest):
    """Differs from 7.3 in one cell of a command."""

    def __init__(self, cell: tuple[Mode, Asked], step: Transition) -> None:
        super().__init__()
        self._cell, self._step = (cell[0], Stimulus(cell[1])), step

    def _scan(self) -> None:
        right = TRANSITIONS[self._cell]
        TRANSITIONS[self._cell] = self._step
        try:
            super()._scan()
        finally:
            TRANSITIONS[self._cell] = right


class TakesReferencesOtherwise(ControllerUnderTest):
    """Differs from 7.3 in one cell of a reference: it answers otherwise, or is in another mode after it."""

    def __init__(self, cell: tuple[Mode, Asked], step: Transition) -> None:
        super().__init__()
        self._mode, self._asked = cell
        self._step = step
        self._came: set[int] = set()
        self._applies: set[int] = set()

    def judge(self, request: Request) -> Request:
        if isinstance(request, ReferencePose) and self._asked is Asked.MOVE:
            self._came.add(request.command_id)
        return request

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        if self._asked is Asked.STREAMED:
            self._came.add(arrival.message.number)
        return arrival

    def _scan(self) -> None:
        self._applies = self._came if self.bench.state.mode is self._mode else set()
        self._came = set()
        super()._scan()
        right = ANSWERS[self._mode, self._asked]
        if self._applies and self._step.mode is not right.mode:
            self.bench.state = enter_mode(self.settings, self.bench.state, self._step.mode)
        if self._applies and self._asked is Asked.STREAMED and self._step.reason is not right.reason:
            number, stream = self._applies.pop(), self.bench.state.motion.motion_id
            self.server.refuse_streamed(
                StreamRefused(stream, number, self._step.reason, 0.0, 0.0), self.bench.now_ns
            )

    def answered(self, acknowledgement: Acknowledgement) -> list[Acknowledgement]:
        if acknowledgement.command_id in self._applies:
            return [acknowledgement._replace(reason=self._step.reason)]
        return [acknowledgement]


def wrong_reason(step: Transition) -> Transition:
    """``step`` with another answer."""
    accepted = step.reason is Reason.ACCEPTED
    return step._replace(reason=Reason.ALREADY_DONE if accepted else Reason.ACCEPTED)


def wrong_mode(mode: Mode, asked: Asked, step: Transition) -> Transition:
    """``step`` to another mode: none where it acts, and where it does not, the one it leads to elsewhere."""
    if step.mode is not mode:
        return step._replace(mode=mode)
    elsewhere = _ELSEWHERE[asked]
    if elsewhere is mode:  # it leads here anyway
        elsewhere = Mode.DISABLED if mode is not Mode.DISABLED else Mode.STANDBY
    return step._replace(mode=elsewhere)


def _of_cells() -> Iterator[BrokenController]:
    for (mode, asked), step in ANSWERS.items():
        for what, wrong in (("answers", wrong_reason(step)), ("leads", wrong_mode(mode, asked, step))):
            refused = asked is Asked.STREAMED and what == "answers" and mode is not Mode.STREAMING
            by_table = refused or asked not in (Asked.MOVE, Asked.STREAMED)
            kind = OfAnotherTable if by_table else TakesReferencesOtherwise
            name = f"{asked.name} in {mode.name} {what} {wrong.mode.name}: {wrong.reason.name}"
            yield BrokenController(
                name, "7.3", partial(kind, (mode, asked), wrong), case=number_of(mode, asked)
            )


MUTANTS = tuple(_of_cells())
