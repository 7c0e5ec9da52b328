"""Everything that vision's end of the reference link heard in a run, and its story in the run's log."""

from protocol.faults import FaultCode, GroupState
from protocol.reference_messages import State
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    DatagramDropped,
    SessionLost,
    StateReceived,
    StreamRefusedReceived,
)
from testbed.lockstep.clock import LockstepClock
from testbed.lockstep.run_log import RunLog
from vision_pc.application.reference_link import Streamed, Submitted


class LinkRecord:
    """Implements ``vision_pc.application.reference_link.Journal``; ``states`` are all that came."""

    def __init__(self, log: RunLog, clock: LockstepClock) -> None:
        self.states: list[State] = []
        self._log = log
        self._clock = clock

    def __call__(self, event: Submitted | Streamed | ClientEvent) -> None:
        """Write what a reader of the run's log wants to know of ``event``."""
        if isinstance(event, StateReceived):
            self._received(event.state)
        elif isinstance(event, Submitted):
            self._add("request", id=event.command_id, kind=type(event.request).__name__)
        elif isinstance(event, AcknowledgementReceived):
            answer = event.acknowledgement
            self._add("acknowledgement", id=answer.command_id, reason=answer.reason.name)
        elif isinstance(event, StreamRefusedReceived):
            self._add("stream_refused", reason=event.refusal.reason.name)
        elif isinstance(event, SessionLost):
            self._add("link_lost", reason=event.reason.name)
        elif isinstance(event, DatagramDropped):
            self._add("datagram_dropped", cause=event.cause)

    def _received(self, state: State) -> None:
        if not self.states or _noteworthy(self.states[-1], state):
            self._add(
                "state",
                group=GroupState(state.group_state).name,
                fault=FaultCode(state.fault).name,
                motion=state.motion_id,
                segment=state.segment,
                p_m=state.X_BT.p_m,
            )
        self.states.append(state)

    def _add(self, event: str, **fields: object) -> None:
        self._log.add(self._clock.time_ns, event, **fields)


def _noteworthy(before: State, after: State) -> bool:
    """Return True if something changed that a reader of the event log wants to know."""
    return (before.group_state, before.fault, before.motion_id, before.motion_done, before.segment) != (
        after.group_state,
        after.fault,
        after.motion_id,
        after.motion_done,
        after.segment,
    )
