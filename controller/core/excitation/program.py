"""Trying out the valves as the controller's scan: states and watches as ever, the servo's valves replaced.

ENABLE begins the excitation, which shows as MOVING. STOP, DISABLE, the emergency stop, a silent link, a fault
and every limit of the excitation centre all valves in the same scan, and end it. ENABLE anew goes on with
the joint that was not finished.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.excitation.plan import (
    N_JOINTS,
    Excitation,
    ExcitationPlan,
    Failure,
    Measured,
    Phase,
    StrokeKind,
    begun,
    driven,
)
from controller.core.excitation.strokes import ended, excite
from controller.core.requests import enter_mode
from controller.core.scan import scan
from controller.core.scan_types import ScanEvent, ScanInput, ScanOutput, ScanState, Sextuple, idle
from controller.core.servo.servo_step import full_spool_speeds
from controller.core.settings import ScanSettings
from controller.core.trajectories.motion import start_motion
from controller.core.trajectories.paths import straight
from protocol.axes_group import Mode
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, Command, Request

_UNLOADED = np.zeros(N_JOINTS)


class ExcitationProgram(NamedTuple):
    """``inner``: the scan's own. ``excitation``: None until the group was enabled; ``stroke``: the first one
    of the joint that comes next. ``failure``: what broke the latest excitation off."""

    inner: ScanState
    excitation: Excitation | None = None
    stroke: int = 0
    failure: Failure | None = None

    def finished(self, settings: ExcitationPlan) -> bool:
        """Return True once every stroke was driven."""
        return self.stroke >= len(settings.strokes)


class ExcitationSample(NamedTuple):
    """What one scan of a stroke leaves for the record: readings, and the command that answers them.

    ``stroke``: index into the settings' strokes. ``driving``: False at rest between strokes. ``valve``: of
    the stroke's joint. ``pressures_bar`` (6, 2); ``full_speed`` (2,), rad/s: nominal, of the joint at full
    spool, raising and lowering, unloaded.
    """

    time_ns: int
    stroke: int
    driving: bool
    valve: float
    q: np.ndarray
    pressures_bar: tuple[tuple[float, float], ...]
    supply_bar: float
    return_bar: float
    full_speed: tuple[float, float]


def excitation_scan(
    settings: ScanSettings, plan: ExcitationPlan, state: ExcitationProgram, inputs: ScanInput
) -> tuple[ExcitationProgram, ScanOutput, ExcitationSample | None]:
    """The state after this scan, what it puts out, and what it recorded; pure, as ``scan``."""
    kept, refused = _without_references(state, inputs.requests)
    inner, output = scan(settings, state.inner, inputs._replace(requests=kept))
    events = list(output.events)
    state = state._replace(inner=inner)
    sample = None
    if inner.mode is Mode.STANDBY and state.excitation is None and not state.finished(plan):
        state = _start_program(state)
        events.append(ScanEvent("excitation", "begun", float(state.stroke), float(len(plan.strokes))))
    elif inner.mode is not Mode.MOVING:
        state = _after_stop(state, inner.mode)
    elif state.excitation is not None:
        state, sample = _excited(settings, plan, state, inputs, events)
    state = _with_idle_servo(state)
    valves = _valves(plan, state)
    output = output._replace(
        valves=output.valves._replace(valves=valves),
        acknowledgements=(*refused, *output.acknowledgements),
        view=output.view._replace(valves=valves),
        events=tuple(events),
    )
    return state, output, sample


def _without_references(
    state: ExcitationProgram, requests: tuple[Request, ...]
) -> tuple[tuple[Request, ...], tuple[Acknowledgement, ...]]:
    """What the scan may judge, and the refusals of references: none is followed meanwhile."""
    if state.inner.mode not in (Mode.STANDBY, Mode.MOVING):
        return requests, ()
    kept = tuple(each for each in requests if isinstance(each, Command))
    refused = [each for each in requests if not isinstance(each, Command)]
    return kept, tuple(Acknowledgement(each.command_id, Reason.MOVING, 0.0, 0.0) for each in refused)


def _start_program(state: ExcitationProgram) -> ExcitationProgram:
    """``state`` in motion: the group's desired motion stands for as long as valves are tried out."""
    inner = state.inner
    tool = inner.tool
    standing = straight(tool.p_BT, tool.quaternion, tool.p_BT, tool.quaternion)._replace(duration_s=math.inf)
    motion = start_motion(standing, inner.motion.motion_id)
    excitation = begun(inner.watch.q_meas, state.stroke)
    return state._replace(
        inner=inner._replace(mode=Mode.MOVING, motion=motion), excitation=excitation, failure=None
    )


def _after_stop(state: ExcitationProgram, mode: Mode) -> ExcitationProgram:
    """``state`` after a stop or a fault; what is disabled may be enabled, and begun, again."""
    if state.excitation is None:
        return state
    if mode is Mode.STANDBY or state.inner.mode is Mode.STOPPING:
        return state._replace(excitation=ended(state.excitation))
    return state._replace(excitation=None)


def _excited(
    settings: ScanSettings,
    plan: ExcitationPlan,
    state: ExcitationProgram,
    inputs: ScanInput,
    events: list[ScanEvent],
) -> tuple[ExcitationProgram, ExcitationSample | None]:
    before, watch, sensors = state.excitation, state.inner.watch, state.inner.watch.sensors
    assert before is not None
    assert sensors is not None
    servo = settings.servo
    full_speed = full_spool_speeds(servo.drives, watch.q_meas, servo.rated, servo.rated, _UNLOADED)
    greatest = max(max(pair) for pair in sensors.pressures_bar)
    now, failure = excite(plan, before, Measured(watch.q_meas, greatest), inputs.dt_s)
    state = state._replace(excitation=now)
    if failure is not None:
        events.append(ScanEvent("excitation", failure.cause, failure.value, failure.limit))
        state = state._replace(failure=failure)
    elif now.stroke != before.stroke:
        state = _next_stroke(plan, state, events)
    if now.phase is Phase.ENDED:
        state = state._replace(inner=enter_mode(settings, state.inner, Mode.STOPPING))
    joint = plan.strokes[before.stroke].joint
    driving = now.stroke != before.stroke or now.phase not in (Phase.RESTING, Phase.RETURNING)
    sample = ExcitationSample(
        inputs.now_ns,
        before.stroke,
        driving,
        0.0 if now.phase is Phase.RETURNING else now.spool,
        watch.q_meas,
        sensors.pressures_bar,
        sensors.supply_bar,
        sensors.return_bar,
        (float(full_speed[joint, 0]), float(full_speed[joint, 1])),
    )
    return state, sample


def _next_stroke(
    plan: ExcitationPlan, state: ExcitationProgram, events: list[ScanEvent]
) -> ExcitationProgram:
    """``state`` with a joint's strokes counted as done once all of them were driven."""
    assert state.excitation is not None
    stroke, count = state.excitation.stroke, len(plan.strokes)
    done = stroke == count or (
        plan.strokes[stroke].kind is StrokeKind.SEARCH and plan.strokes[stroke].outward
    )
    if not done:
        return state
    events.append(ScanEvent("excitation", "joint_done", float(plan.strokes[stroke - 1].joint), count))
    return state._replace(stroke=stroke)


def _with_idle_servo(state: ExcitationProgram) -> ExcitationProgram:
    """``state`` whose servo holds nothing.

    The measured speeds stand for commanded ones, so that the watches over ranges and workspace know whether
    the arm comes back. The valves are not shown to the watch over stuck encoders: inside an unknown deadband
    a joint stands still rightly, and the excitation has a limit of its own for that.
    """
    inner = state.inner
    qd = inner.watch.qd_meas
    servo = idle(inner.watch.q_meas)._replace(qd_cmd=qd, v_desired=inner.tool.J_BT[:3] @ qd)
    return state._replace(inner=inner._replace(servo=servo))


def _valves(plan: ExcitationPlan, state: ExcitationProgram) -> Sextuple:
    """One valve as excited, the others centred."""
    valves = [0.0] * N_JOINTS
    excitation = state.excitation
    if state.inner.mode is Mode.MOVING and excitation is not None and excitation.phase is not Phase.ENDED:
        valves[driven(plan, excitation)] = excitation.spool
    a, b, c, d, e, f = valves
    return a, b, c, d, e, f
