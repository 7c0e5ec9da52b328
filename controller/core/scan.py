"""One scan of the controller: input image → output image, pure.

Order: look at the plant, judge it, answer requests, take the streamed reference or judge its absence,
advance the desired motion, drive the valves.
"""

import numpy as np

from controller.core.group_states import Stimulus, transition
from controller.core.kinematics.rotations import Array
from controller.core.parking.joint import joints_in_motion
from controller.core.parking.parking import control_step
from controller.core.plant_watch import cycle_frozen, link_lost, update_watch
from controller.core.references.streaming import pace, silence, update_fade
from controller.core.requests import answer_request, enter_mode, follow_reference, is_live, react_to_fault
from controller.core.scan_types import (
    ControllerView,
    ScanEvent,
    ScanInput,
    ScanOutput,
    ScanState,
    Sextuple,
    idle,
)
from controller.core.servo.joint_control import JointFilters, Pressures, unmoved
from controller.core.servo.servo_step import (
    FURTHEST,
    HELD,
    LOAD,
    PILOT,
    PT1,
    Q_CMD,
    QD_CMD,
    ROWS,
    SENSE,
    VALVES,
    Circuit,
    ServoInput,
    load_pressures,
    pilot_pressures,
    servo_step,
    tool_state,
)
from controller.core.servo.settling import MOVING
from controller.core.settings import ScanSettings
from controller.core.standing import is_settled, rest_after, rest_before, stands_now
from controller.core.supervision import Evidence, Fault, ServoOutput, first_fault, readings, update_timers
from controller.core.trajectories.motion import advance, at_standstill
from protocol.axes_group import GROUP_STATE, Mode
from protocol.faults import FaultCode
from protocol.pose import Pose
from protocol.process_image import CONTROL_ENABLE, CONTROL_RESET_WATCHDOG, STATUS_WATCHDOG_TRIPPED, ValveImage
from protocol.reference_messages import (
    FLAG_EMERGENCY_LATCHED,
    FLAG_PLANT_LINK_OK,
    FLAG_SETTLED,
    FLAG_STREAMING,
    Acknowledgement,
)

# The plant may take the watchdog's reset on the edge or on the level: a slow square wave serves both.
_RESET_HALF_PERIOD = 8  # [D]
_UNLOADED = np.zeros(6)


def scan(settings: ScanSettings, state: ScanState, inputs: ScanInput) -> tuple[ScanState, ScanOutput]:
    """The state after this scan, and what it puts out. The same arguments give the same bits."""
    events: list[ScanEvent] = []
    mode_before = state.mode
    watch = update_watch(state.watch, inputs.sensors, state.cycle, inputs.dt_s)
    state = state._replace(cycle=state.cycle + 1, watch=watch, tool=tool_state(settings.table, watch.q_meas))
    state = _supervise(settings, state, inputs, events)
    acknowledgements: list[Acknowledgement] = []
    latched = state.fault
    for request in inputs.requests:
        state, acknowledgement = answer_request(settings, state, inputs, request)
        acknowledgements.append(acknowledgement)
        events.append(_answer_event(request, acknowledgement))
    refusal = None
    if inputs.streamed is not None:
        state, refusal = follow_reference(settings, state, inputs.streamed, inputs.now_ns)
        if refusal is not None:
            events.append(ScanEvent("streamed", refusal.reason.name, refusal.value, refusal.limit))
    if state.fault is not latched and state.fault.code is not FaultCode.NONE:  # an emergency stop
        events.append(ScanEvent("fault", state.fault.code.name, state.fault.value, state.fault.limit))
    state = _watch_stream(settings, state, inputs, events)
    state = _advance_motion(settings, state, inputs.dt_s)
    state = _drive_valves(settings, state, inputs.dt_s, events)
    if state.mode is not mode_before:
        events.append(ScanEvent("mode", f"{mode_before.name} -> {state.mode.name}", 0.0, 0.0))
    state = _rearm_watchdog(state)
    valves = _valve_image(state)
    view = _view(settings, state, inputs.sensed_ns)
    return state, ScanOutput(valves, tuple(acknowledgements), refusal, view, tuple(events))


def _answer_event(request: object, answer: Acknowledgement) -> ScanEvent:
    name = f"{type(request).__name__} {answer.command_id}"
    return ScanEvent(name, answer.reason.name, answer.value, answer.limit)


def _supervise(
    settings: ScanSettings, state: ScanState, inputs: ScanInput, events: list[ScanEvent]
) -> ScanState:
    """``state`` after judging the plant and the reference link; only while the valves are live."""
    if not is_live(state):
        return state
    found = readings(settings, state.watch, state.servo, state.tool)
    timers = update_timers(settings, state.timers, state.watch, found, inputs.dt_s)
    state = state._replace(timers=timers)
    evidence = Evidence(settings, state.watch, timers, state.servo, state.tool.p_BT, found, inputs.dt_s)
    fault = first_fault(evidence)
    if fault is not None:
        state, event = react_to_fault(settings, state, fault)
        events.append(event)
    if not inputs.reference_link_alive and is_live(state):
        if state.mode is Mode.MOVING:  # a motion may not continue unattended
            state, event = react_to_fault(settings, state, Fault(FaultCode.REFERENCE_LINK_LOST, 0.0, 0.0))
            events.append(event)
        else:
            after = transition(state.mode, Stimulus.UNATTENDED).mode
            if after is not state.mode:
                events.append(ScanEvent("unattended", FaultCode.REFERENCE_LINK_LOST.name, 0.0, 0.0))
            state = enter_mode(settings, state, after)
            if state.stream is not None:
                state = state._replace(stream=state.stream._replace(attended=False))
    return state


def _watch_stream(
    settings: ScanSettings, state: ScanState, inputs: ScanInput, events: list[ScanEvent]
) -> ScanState:
    """``state`` at the pace that the stream's silence leaves it; at the limit it ends in a fault."""
    if state.stream is not None:
        silent_s, limit_s = silence(settings, state.stream, inputs.now_ns)
        if silent_s > limit_s:
            state, event = react_to_fault(
                settings, state, Fault(FaultCode.REFERENCE_STALE, silent_s, limit_s)
            )
            events.append(event)
    fade = update_fade(settings, state.fade, state.stream, inputs.now_ns, inputs.dt_s)
    return state if fade == state.fade else state._replace(fade=fade)


def _advance_motion(settings: ScanSettings, state: ScanState, dt_s: float) -> ScanState:
    """``state`` with the desired motion advanced, and the mode that follows when it comes to rest."""
    if not is_live(state) or state.mode is Mode.STANDBY:
        return state
    motion = advance(state.motion, dt_s * pace(state.fade))
    if state.mode is Mode.STREAMING:  # a way that ends does not end the stream
        motion = motion._replace(done=False)
    state = state._replace(motion=motion)
    if at_standstill(state.motion):
        state = enter_mode(settings, state, transition(state.mode, Stimulus.STANDSTILL).mode)
    return state


def _drive_valves(
    settings: ScanSettings, state: ScanState, dt_s: float, events: list[ScanEvent]
) -> ScanState:
    """``state`` with new valve commands: (4), (5), (6), (25) while live, else centred."""
    if not is_live(state):
        return _centre_valves(settings, state)
    desired, (settling, parking) = state.motion.desired, rest_before(state)
    circuit, slow_load = _circuit(settings, state)
    given = ServoInput(
        state.tool,
        desired,
        pace(state.fade),
        state.watch.q_meas,
        state.servo.q_cmd,
        state.filters,
        _pressures(settings, state),
        circuit,
        slow_load,
        settling,
    )
    out = np.empty((ROWS, 6))
    if settings.parking is None or not stands_now(state):
        finite, stands = servo_step(settings.servo, given, dt_s, out)
        stands = stands and bool(out[HELD].all())  # what an integral still drives will move
    else:
        settled = is_settled(settings, state)
        finite, stands = control_step(
            settings.servo, settings.parking, given, state.watch.qd_meas, settled, out, parking
        )
    if not finite:
        state, event = react_to_fault(settings, state, Fault(FaultCode.NUMERIC, float("nan"), 0.0))
        events.append(event)
        return _centre_valves(settings, state)
    state = rest_after(settings, state._replace(parking=parking), stands, out, events)
    return state._replace(
        servo=ServoOutput(out[Q_CMD], out[QD_CMD], out[VALVES], desired.v),
        filters=JointFilters(out[PT1], out[LOAD], out[SENSE], out[FURTHEST], out[PILOT]),
    )


def _pressures(settings: ScanSettings, state: ScanState) -> Pressures:
    sensors, drives = state.watch.sensors, settings.servo.drives
    if sensors is None:
        return Pressures(state.filters.load, state.filters.pilot)
    chambers = sensors.pressures_bar
    return Pressures(load_pressures(drives, chambers), pilot_pressures(drives, chambers))


def _circuit(settings: ScanSettings, state: ScanState) -> tuple[Circuit, Array]:
    """The circuit and slow load pressures (6,), or rated and unloaded when no compensation is wanted."""
    sensors = state.watch.sensors
    if sensors is None or not settings.load_compensation:
        return settings.servo.rated, _UNLOADED
    return Circuit(sensors.supply_bar, sensors.return_bar), state.filters.load


def _centre_valves(settings: ScanSettings, state: ScanState) -> ScanState:
    """``state`` at rest; the slow load pressure follows the load, so enabling starts without a kick."""
    filters = unmoved(_pressures(settings, state).load, state.filters.pilot)
    return state._replace(
        servo=idle(state.watch.q_meas),
        filters=filters,
        settled_s=0.0,
        settling=MOVING,
        parking=joints_in_motion(),
    )


def _rearm_watchdog(state: ScanState) -> ScanState:
    """``state`` with the plant's watchdog asked to be re-armed while the plant says that it tripped.

    Only while the enable is dropped: nothing can move then, and the latched fault still needs its RESET. The
    first edge goes out at once, so the plant is ready before an operator can have asked for RESET and ENABLE.
    """
    sensors = state.watch.sensors
    tripped = sensors is not None and sensors.status & STATUS_WATCHDOG_TRIPPED
    rearming = state.rearming + 1 if tripped and not is_live(state) else 0
    return state if rearming == state.rearming else state._replace(rearming=rearming)


def _valve_image(state: ScanState) -> ValveImage:
    control = CONTROL_ENABLE if is_live(state) else 0
    if state.rearming and (state.rearming - 1) // _RESET_HALF_PERIOD % 2 == 0:
        control |= CONTROL_RESET_WATCHDOG
    return ValveImage(state.cycle, control, _six(state.servo.valves))


def _six(values: np.ndarray) -> Sextuple:
    a, b, c, d, e, f = values.tolist()
    return a, b, c, d, e, f


def _pose(p: np.ndarray, quaternion: np.ndarray) -> Pose:
    x, y, z = p.tolist()
    w, i, j, k = quaternion.tolist()
    return Pose((x, y, z), (w, i, j, k))


def _view(settings: ScanSettings, state: ScanState, sensed_ns: int) -> ControllerView:
    watch, motion = state.watch, state.motion
    healthy = link_lost(settings, watch) is None and cycle_frozen(settings, watch) is None
    flags = (
        (FLAG_PLANT_LINK_OK if healthy else 0)
        | (FLAG_EMERGENCY_LATCHED if state.mode is Mode.EMERGENCY else 0)
        | (FLAG_SETTLED if is_settled(settings, state) else 0)
        | (FLAG_STREAMING if state.mode is Mode.STREAMING else 0)
    )
    X_BT = _pose(state.tool.p_BT, state.tool.quaternion)
    return ControllerView(
        time_ns=sensed_ns,
        cycle=state.cycle,
        group_state=GROUP_STATE[state.mode],
        fault=state.fault.code,
        severity=state.severity,
        flags=flags,
        motion_id=motion.motion_id,
        motion_done=motion.done,
        segment=motion.segment,
        q_meas=_six(watch.q_meas),
        q_cmd=_six(state.servo.q_cmd),
        valves=_six(state.servo.valves),
        X_BT=X_BT,
        X_BT_cmd=_pose(motion.desired.p, motion.desired.quaternion) if is_live(state) else X_BT,
        supply_bar=watch.sensors.supply_bar if watch.sensors is not None else 0.0,
        plant_exchange_failures=watch.failures,
        stream_number=state.stream.number if state.stream is not None else 0,
    )
