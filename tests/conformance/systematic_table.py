"""For every cell of table 7.3 a controller that answers otherwise, and one that goes elsewhere.

They are otherwise sound: the table of the scan differs in that cell alone.
"""

from collections.abc import Iterator
from typing import Any

from conformance.reference.arm_transitions import number_of
from controller.core.group_states import Stimulus
from controller.core.requests import enter_mode
from protocol.axes_group import ANSWERS, GroupRequest, Mode, Transition
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, ReferencePose, StreamRefused
from protocol.session_events import StreamedPoseReceived
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutator import BrokenController, Make, hooked, with_cell

# Where a request leads that is taken for one that acts. What leads to a motion without a way ends in the
# same scan and cannot be told, so these drop the enable instead.
_ELSEWHERE = {
    GroupRequest.ENABLE: Mode.STANDBY,
    GroupRequest.DISABLE: Mode.DISABLED,
    GroupRequest.STOP: Mode.DISABLED,
    GroupRequest.RESET: Mode.DISABLED,
    GroupRequest.EMERGENCY_STOP: Mode.ERROR_HELD,
    GroupRequest.EMERGENCY_RELEASE: Mode.ERROR_HELD,
    GroupRequest.START_STREAM: Mode.STREAMING,
    GroupRequest.END_STREAM: Mode.DISABLED,
    GroupRequest.MOVE: Mode.DISABLED,
    GroupRequest.STREAMED: Mode.DISABLED,
}


def _takes_otherwise(cell: tuple[Mode, GroupRequest], step: Transition) -> Make:
    """Differs from 7.3 in one cell of a reference: it answers otherwise, or is in another mode after it."""
    mode, asked = cell
    right = ANSWERS[cell]
    members: dict[str, Any] = {"came": frozenset(), "applies": frozenset()}

    def judge(self: Any, message: Any) -> Any:
        if isinstance(message, ReferencePose):
            self.came = self.came | {message.command_id}
        return message

    def judge_streamed(self: Any, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        self.came = self.came | {arrival.message.number}
        return arrival

    def scan(self: Any) -> None:
        self.applies = self.came if self.bench.state.mode is mode else frozenset()
        self.came = frozenset()
        ControllerUnderTest._scan(self)
        if self.applies and step.mode is not right.mode:
            self.bench.state = enter_mode(self.settings, self.bench.state, step.mode)
        if self.applies and asked is GroupRequest.STREAMED and step.reason is not right.reason:
            stream = self.bench.state.motion.motion_id
            refused = StreamRefused(stream, next(iter(self.applies)), step.reason, 0.0, 0.0)
            self.applies = frozenset()
            self.server.refuse_streamed(refused, self.bench.now_ns)

    def answered(self: Any, acknowledgement: Acknowledgement) -> list[Acknowledgement]:
        concerned = acknowledgement.command_id in self.applies
        return [acknowledgement._replace(reason=step.reason) if concerned else acknowledgement]

    hook = {"judge": judge} if asked is GroupRequest.MOVE else {"judge_streamed": judge_streamed}
    return hooked(_scan=scan, answered=answered, **hook, **members)


def wrong_reason(step: Transition) -> Transition:
    """``step`` with another answer."""
    accepted = step.reason is Reason.ACCEPTED
    return step._replace(reason=Reason.ALREADY_DONE if accepted else Reason.ACCEPTED)


def wrong_mode(mode: Mode, asked: GroupRequest, step: Transition) -> Transition:
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
            refused = asked is GroupRequest.STREAMED and what == "answers" and mode is not Mode.STREAMING
            by_table = refused or asked not in (GroupRequest.MOVE, GroupRequest.STREAMED)
            make = (
                with_cell((mode, Stimulus(asked)), wrong)
                if by_table
                else _takes_otherwise((mode, asked), wrong)
            )
            name = f"{asked.name} in {mode.name} {what} {wrong.mode.name}: {wrong.reason.name}"
            yield BrokenController(name, "7.3", make, case=number_of(mode, asked))


MUTANTS = tuple(_of_cells())
