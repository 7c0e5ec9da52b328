"""Commands and references, answered: each exactly once, from the transition table and the guards.

Streamed references are answered only when they are refused.
"""

from controller.core.group_states import LIVE, Stimulus, transition
from controller.core.plant_watch import link_lost
from controller.core.references.admission import Refusal, admit
from controller.core.references.streaming import OpenStream, follow, last_approach
from controller.core.scan_types import NO_FAULT, ScanEvent, ScanInput, ScanState, idle
from controller.core.settings import ScanSettings
from controller.core.supervision import REACTIONS, RESTED, Fault, plant_ready
from controller.core.trajectories.approach import ApproachTrajectory
from controller.core.trajectories.motion import holding, start_motion, start_stop
from protocol.axes_group import Mode
from protocol.faults import CommandCode, FaultCode, Reason, Severity
from protocol.reference_messages import (
    Acknowledgement,
    Command,
    ReferencePath,
    ReferencePose,
    Request,
    StreamRefused,
)
from protocol.session_events import StreamedPoseReceived


def answer_request(
    settings: ScanSettings, state: ScanState, inputs: ScanInput, request: Request
) -> tuple[ScanState, Acknowledgement]:
    """The state after ``request``, and its acknowledgement."""
    if isinstance(request, Command):
        state, refusal = _obey_command(settings, state, inputs, request)
    else:
        state, refusal = _accept_reference(settings, state, inputs, request)
    return state, Acknowledgement(request.command_id, *refusal)


def follow_reference(
    settings: ScanSettings, state: ScanState, arrival: StreamedPoseReceived, now_ns: int
) -> tuple[ScanState, StreamRefused | None]:
    """The state after a streamed reference, and its refusal if it is not followed."""
    step = transition(state.mode, Stimulus.STREAMED)
    if state.stream is None:
        stream_id = arrival.message.stream_id if step.reason is Reason.NOT_STREAMING else 0
        found: Refusal | tuple[OpenStream, ApproachTrajectory] = Refusal(step.reason, float(stream_id), 0.0)
    else:
        stands = state.watch.q_meas, state.tool.J_BT
        found = follow(settings, state.stream, state.motion.desired, *stands, arrival, now_ns)
    if isinstance(found, Refusal):
        return state, StreamRefused(arrival.message.stream_id, arrival.message.number, *found)
    stream, planned = found
    return state._replace(stream=stream, motion=start_motion(planned, stream.stream_id), settled_s=0.0), None


def enter_mode(settings: ScanSettings, state: ScanState, mode: Mode) -> ScanState:
    """``state`` in ``mode``, with what belongs to the change: nothing jumps, stops begin, errors are
    cleared, a stream that is left is closed."""
    if mode is state.mode:
        return state
    if state.mode is Mode.STREAMING:
        state = state._replace(stream=None)
    if state.mode is Mode.DISABLED and mode is Mode.STANDBY:
        hold = holding(state.tool.p_BT, state.tool.quaternion, state.motion.motion_id)
        servo = idle(state.watch.q_meas)
        state = state._replace(motion=hold, servo=servo, timers=RESTED, settled_s=0.0)
    elif mode in (Mode.STOPPING, Mode.DISABLING, Mode.ERROR_RAMP):
        state = state._replace(motion=start_stop(settings.stop, state.motion))
    elif mode is Mode.DISABLED and state.mode is Mode.ERROR_HELD:
        state = state._replace(fault=NO_FAULT, severity=Severity.NONE)
    return state._replace(mode=mode)


def react_to_fault(settings: ScanSettings, state: ScanState, fault: Fault) -> tuple[ScanState, ScanEvent]:
    """``state`` after ``fault``: the reaction follows the gravest, the latched cause stays the first."""
    severity, stimulus = REACTIONS[fault.code]
    state = enter_mode(settings, state, transition(state.mode, stimulus).mode)
    if state.fault.code is FaultCode.NONE:
        state = state._replace(fault=fault)
    state = state._replace(severity=max(state.severity, severity))
    return state, ScanEvent("fault", fault.code.name, fault.value, fault.limit)


def _obey_command(
    settings: ScanSettings, state: ScanState, inputs: ScanInput, command: Command
) -> tuple[ScanState, Refusal]:
    if command.code not in CommandCode.__members__.values():
        return state, Refusal(Reason.UNKNOWN_COMMAND, float(command.code), float(max(CommandCode)))
    step = transition(state.mode, Stimulus(command.code))
    if step.reason is Reason.ACCEPTED:
        reason = _guard(settings, state, inputs, command.code)
        if reason is not Reason.ACCEPTED:
            return state, Refusal(reason, 0.0, 0.0)
    if command.code is CommandCode.EMERGENCY_STOP and step.reason is Reason.ACCEPTED:
        state, _ = react_to_fault(settings, state, Fault(FaultCode.EMERGENCY_STOP, 0.0, 0.0))
    elif command.code is CommandCode.START_STREAM and step.reason is Reason.ACCEPTED:
        stream = OpenStream(command.command_id, True, inputs.now_ns)
        hold = holding(state.motion.desired.p, state.motion.desired.quaternion, command.command_id)
        state = enter_mode(settings, state, step.mode)._replace(stream=stream, motion=hold, settled_s=0.0)
    elif command.code is CommandCode.END_STREAM and step.reason is Reason.ACCEPTED:
        state = enter_mode(settings, _to_last_reference(state), step.mode)
    else:
        state = enter_mode(settings, state, step.mode)
    return state, Refusal(step.reason, 0.0, 0.0)


def _guard(settings: ScanSettings, state: ScanState, inputs: ScanInput, code: CommandCode) -> Reason:
    """What the table cannot know: whether links and plant allow what would begin or clear something."""
    if code is CommandCode.END_STREAM and state.stream is not None and not state.stream.attended:
        return Reason.NOT_STREAMING
    if code is CommandCode.START_STREAM and not inputs.reference_link_alive:
        return Reason.REFERENCE_LINK_DOWN
    if code not in (CommandCode.ENABLE, CommandCode.RESET):
        return Reason.ACCEPTED
    if link_lost(settings, state.watch) is not None:
        return Reason.PLANT_LINK_DOWN
    if not inputs.reference_link_alive:
        return Reason.REFERENCE_LINK_DOWN
    if code is CommandCode.ENABLE and not plant_ready(settings, state.watch):
        return Reason.PLANT_NOT_READY
    return Reason.ACCEPTED


def _accept_reference(
    settings: ScanSettings, state: ScanState, inputs: ScanInput, request: ReferencePose | ReferencePath
) -> tuple[ScanState, Refusal]:
    step = transition(state.mode, Stimulus.MOVE)
    if step.mode is not Mode.MOVING:
        return state, Refusal(step.reason, 0.0, 0.0)
    if not inputs.reference_link_alive:
        return state, Refusal(Reason.REFERENCE_LINK_DOWN, 0.0, 0.0)
    found = admit(settings, state.motion.desired, state.watch.q_meas, request)
    if isinstance(found, Refusal):
        return state, found
    state = state._replace(motion=start_motion(found, request.command_id), settled_s=0.0)
    return enter_mode(settings, state, Mode.MOVING), Refusal(Reason.ACCEPTED, 0.0, 0.0)


def _to_last_reference(state: ScanState) -> ScanState:
    """``state`` on its way to rest at the newest streamed reference; done at once when there was none."""
    assert state.stream is not None
    planned = last_approach(state.stream, state.motion.desired)
    if planned is None:
        return state._replace(motion=state.motion._replace(done=True))
    return state._replace(motion=start_motion(planned, state.stream.stream_id))


def is_live(state: ScanState) -> bool:
    """Whether the servo drives the valves."""
    return state.mode in LIVE
