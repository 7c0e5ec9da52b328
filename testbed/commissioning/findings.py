"""What commissioning found of one joint, judged, and of all of them as commissioned.yaml."""

import cmath
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from controller.commissioning import basis_of
from controller.config import ControllerConfig
from nominal_arm.commissioned import (
    Commissioned,
    JointPlay,
    JointTuning,
    JointValve,
    MeasuredNumber,
    ValveEdge,
    ValveSet,
)
from nominal_arm.description import JOINT_NAMES, NominalArm
from protocol.errors import MeasurementFailed
from testbed.commissioning.ramp_rows import FrictionFindings, Uncertain, friction_findings, midway
from testbed.commissioning.recording import JointRecording, StrokeRecord, TrialsTold, strokes_in
from testbed.commissioning.valve_fit import UNLIKE_RAD, EdgeFindings, edge_findings
from vision_pc.core.calibration.joint_motion import JointSeen
from vision_pc.core.calibration.joint_play import PlayFound, joint_play, mean_delay


class Margins(NamedTuple):
    """Least phase margin (rad), and how often the gain fits in before the loop swings."""

    phase: float
    gain: float


_SENSES = {1.0: "raising", -1.0: "lowering"}
MARGINS = Margins(math.radians(50.0), 3.0)
_FREQUENCIES = [10.0 ** (0.005 * k - 1.0) for k in range(801)]  # rad/s, 0.1 to 1000


def margins_of(gain: float, lag_s: float, pt1_s: float) -> Margins:
    """The Margins of L(s) = k e^(−s τ) / (s (1 + s T)); infinite where the loop never crosses."""
    phase_margin, gain_margin = math.inf, math.inf
    for omega in _FREQUENCIES:
        loop = gain / (1j * omega * (1.0 + 1j * omega * pt1_s))
        phase = cmath.phase(loop) - omega * lag_s  # from −π/2 downwards, not folded
        if abs(loop) >= 1.0:
            phase_margin = math.pi + phase
        if phase <= -math.pi:
            return Margins(phase_margin, min(gain_margin, 1.0 / abs(loop)))
    return Margins(phase_margin, gain_margin)


def gain_within(gain: float, lag_s: float, pt1_s: float, least: Margins) -> float:
    """``gain``, or what is left of it when the loop shall keep at least these margins."""
    low, high = 0.0, gain
    if _keeps(gain, lag_s, pt1_s, least):
        return gain
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _keeps(middle, lag_s, pt1_s, least) else (low, middle)
    return low


def _keeps(gain: float, lag_s: float, pt1_s: float, least: Margins) -> bool:
    found = margins_of(gain, lag_s, pt1_s)
    return found.phase >= least.phase and found.gain >= least.gain


DEADBAND_MOST = 0.3  # what the compensation can hold
_GAINS = (0.05, 20.0)
RESOLVED = 0.1  # of a play: it is told to 20 % with two of such σ
_LEAST_BAR = 0.05  # friction alone asks for some bar at a reversal
_CURVED = 0.02  # share of the flow at the greatest opening that curvature must make to be told
_KNOTS = (0.25, 0.5, 0.75, 1.0)
_LAST = {
    "supply": "by its supply edge",
    "return": "by its return edge, which opens last",
    "outlet": "by its outlet, the load ran ahead",
    "unknown": "one edge seen: from there to where it surely moves",
}


class JointFindings(NamedTuple):
    """One joint. ``seconds``: of arm time; ``travel`` (rad): the furthest from where it stood; ``opened``:
    the greatest spool beyond the deadband, raising and lowering. ``play``: None where odometry did not see
    enough of the joint's turns; ``unseen``: then why."""

    joint: int
    raising: EdgeFindings
    lowering: EdgeFindings
    friction: FrictionFindings
    seconds: float
    travel: float
    opened: tuple[float, float]
    play: PlayFound | None = None
    unseen: str = ""

    @property
    def resolved(self) -> bool:
        """Whether the play is told to 20 %, by twice its standard deviation."""
        return self.play is not None and self.play.half_std <= RESOLVED * abs(self.play.half)

    @property
    def hysteresis(self) -> Uncertain:
        """Of the spool, by both senses."""
        return midway(self.raising.hysteresis, self.lowering.hysteresis)

    @property
    def lag(self) -> Uncertain:
        """From a slowly changing command to the flow (s), by both senses."""
        return midway(self.raising.lag, self.lowering.lag)


def joint_findings(recording: JointRecording, compensated: bool) -> JointFindings:
    """What ``recording`` says of its joint; ``compensated``: whether the valve's flow is independent of load.

    Raises MeasurementFailed when it says too little (``measurement.no_pressures``: no chamber's pressure
    follows what moves it), when a number sits at its bound
    (``measurement.at_bound``), or when the joint behaves otherwise than the model
    (``measurement.unlike_model``).
    """
    _with_pressures(recording)
    strokes = strokes_in(recording, compensated)
    raising, lowering = (_of_sense(recording.joint, strokes, sense) for sense in _SENSES)
    angle = recording.q[:, recording.joint]
    opened = [
        max((s.u.max() for s in strokes if s.sense == sense), default=0.0) - edge.deadband.value
        for sense, edge in ((1.0, raising), (-1.0, lowering))
    ]
    found = JointFindings(
        recording.joint,
        raising,
        lowering,
        friction_findings(strokes),
        float(recording.t[-1]),
        float(np.abs(angle - angle[0]).max()),
        (float(opened[0]), float(opened[1])),
    )
    for sense, edge in zip(_SENSES, (raising, lowering), strict=True):
        _judge(f"{JOINT_NAMES[recording.joint]} {_SENSES[sense]}", edge)
    return _with_play(found, recording)


def _of_sense(joint: int, strokes: Sequence[StrokeRecord], sense: float) -> EdgeFindings:
    """``edge_findings``, whose refusal names the joint and its sense."""
    try:
        return edge_findings(strokes, sense)
    except MeasurementFailed as error:
        where = f"{JOINT_NAMES[joint]} {_SENSES[sense]}"
        raise MeasurementFailed(error.cause, f"{where}: {error}") from error


def _with_pressures(recording: JointRecording) -> None:
    """A chamber that oil goes into and out of does not keep its pressure to the last digit."""
    for name, pressure in zip("ab", recording.chambers[recording.driving].T, strict=True):
        if len(pressure) and not np.ptp(pressure) > _LEAST_BAR:  # a NaN is no pressure either
            raise MeasurementFailed(
                "measurement.no_pressures",
                f"{JOINT_NAMES[recording.joint]}: chamber {name} stands at {pressure[0]:.4g} bar while the "
                f"valve is tried out: {_LEAST_BAR:g} bar of change are wanted at least",
            )


def _with_play(found: JointFindings, recording: JointRecording) -> JointFindings:
    """``found`` with the joint's play, as far as odometry saw it."""
    if len(recording.seen_t) == 0:
        return found._replace(unseen="no odometry")
    valve = recording.valve * recording.driving
    seen = JointSeen(recording.joint, recording.t, recording.q, valve, recording.seen_t, recording.seen_X)
    try:
        return found._replace(play=joint_play(seen))
    except MeasurementFailed as error:
        return found._replace(unseen=str(error))


def _judge(where: str, edge: EdgeFindings) -> None:
    gain, deadband = edge.gain.value, edge.deadband
    if edge.residual > UNLIKE_RAD:
        raise MeasurementFailed(
            "measurement.unlike_model",
            f"{where}: the model leaves {1e3 * edge.residual:.2f} mrad, limit {1e3 * UNLIKE_RAD:g} mrad",
        )
    if deadband.value + deadband.std >= DEADBAND_MOST:
        raise MeasurementFailed(
            "measurement.at_bound", f"{where}: deadband {deadband.value:.4f}, limit {DEADBAND_MOST:g}"
        )
    if deadband.value < -4.0 * deadband.std:
        raise MeasurementFailed(
            "measurement.unlike_model",
            f"{where}: deadband {deadband.value:.4f} ± {deadband.std:.4f} is below 0: the valve is "
            "open at its centre",
        )
    if not _GAINS[0] < gain < _GAINS[1]:
        raise MeasurementFailed(
            "measurement.at_bound",
            f"{where}: flow over nominal {gain:.3g}, limits {_GAINS[0]:g} and {_GAINS[1]:g}",
        )


def commissioned_from(
    found: Mapping[int, JointFindings],
    arm: NominalArm,
    config: ControllerConfig,
    recordings: Mapping[int, str],
    made: tuple[str, str],
    seen: TrialsTold | None = None,
) -> Commissioned:
    """commissioned.yaml's content: what was ``found`` in place of what ``config`` believed.

    ``recordings``: what each joint's numbers came from. ``made``: when (UTC) and by what. ``seen``: plays
    and delay that the vision PC told, where no odometry is in the recordings.
    """
    valves = {
        JOINT_NAMES[joint]: _valve(one, config.valves.joints[joint], config.cycle_ms, recordings[joint])
        for joint, one in found.items()
    }
    known = ValveSet.model_validate(config.valves.model_copy(update=valves).model_dump())
    return Commissioned(
        made_utc=made[0],
        made_by=made[1],
        basis=basis_of(arm, config),
        valves=known,
        tuning=_tuning(found, config),
        play_mrad=_play(found, recordings, seen),
        camera_delay_ms=_camera_delay(found, seen),
    )


def _play(
    found: Mapping[int, JointFindings], recordings: Mapping[int, str], seen: TrialsTold | None
) -> JointPlay:
    """Half the play of every joint that odometry saw, on whichever side of the encoder."""
    told = {
        JOINT_NAMES[joint]: Uncertain(1e3 * one.play.half, 1e3 * one.play.half_std)
        for joint, one in found.items()
        if one.play is not None
    }
    if seen is not None:
        told = {name: Uncertain(one.value, one.std) for name, one in seen.play_mrad.items()} | told
    return JointPlay(
        **{
            name: _number(Uncertain(abs(one.value), one.std), (None, None), recordings[joint])
            for joint, name in enumerate(JOINT_NAMES)
            if joint in found and (one := told.get(name)) is not None
        }
    )


def _camera_delay(found: Mapping[int, JointFindings], seen: TrialsTold | None) -> MeasuredNumber | None:
    """How late pictures are stamped, by all joints that odometry saw."""
    plays = [one.play for one in found.values() if one.play is not None]
    if plays:
        late, std = mean_delay(plays)
        recording = f"odometry beside {len(plays)} joints"
        return MeasuredNumber(value=1e3 * late, std=1e3 * std, recording=recording)
    if seen is None or seen.camera_delay_ms is None:
        return None
    told = seen.camera_delay_ms
    return MeasuredNumber(value=told.value, std=told.std, recording="valve-trials of the vision PC")


def _valve(found: JointFindings, before: JointValve, cycle_ms: float, recording: str) -> JointValve:
    total_ms = max(1e3 * found.lag.value - cycle_ms, 0.0)  # a command waits for the next exchange
    lag_ms = min(before.lag_ms.value, total_ms)
    hysteresis = found.hysteresis
    return JointValve(
        raising=valve_edge(found.raising, found.opened[0], recording),
        lowering=valve_edge(found.lowering, found.opened[1], recording),
        hysteresis=_number(Uncertain(max(hysteresis.value, 0.0), hysteresis.std), (None, 0.3), recording),
        delay_ms=_number(
            Uncertain(total_ms - lag_ms, math.hypot(1e3 * found.lag.std, before.lag_ms.std)),
            (None, 500.0),
            recording,
        ),
        lag_ms=before.lag_ms.model_copy(update={"value": lag_ms}),
        full_stroke_ms=before.full_stroke_ms,
    )


def valve_edge(edge: EdgeFindings, opened: float, recording: str) -> ValveEdge:
    """The file's entry of one sense: ``opened`` (of spool) is the furthest that it was tried out beyond its
    deadband, ``recording`` what it came from, to which is added by which edge."""
    deadband = Uncertain(max(edge.deadband.value, 0.0), edge.deadband.std)
    return ValveEdge(
        deadband=_number(deadband, (None, DEADBAND_MOST), f"{recording}, {_LAST[edge.last]}"),
        flow_gain=_number(edge.gain, _GAINS, recording),
        curve=_curve(edge, opened),
    )


def _curve(edge: EdgeFindings, opened: float) -> tuple[tuple[float, float], ...]:
    """Knots of the flow beyond the deadband: as far as ``meets`` by the return edge, then by the supply edge,
    which opened ``gap`` before; none where that is a straight line from the deadband on."""
    curved = edge.gap > 0.0 or abs(edge.curvature) * opened > _CURVED
    if not curved or opened <= edge.meets:
        return ()
    openings = [edge.meets] if edge.meets > 0.0 else []
    openings += [edge.meets + share * (opened - edge.meets) for share in _KNOTS]
    return tuple((x, (x + edge.gap) + edge.curvature * (x + edge.gap) ** 2) for x in openings)


def _number(found: Uncertain, bounds: tuple[float | None, float | None], recording: str) -> MeasuredNumber:
    return MeasuredNumber(value=found.value, std=found.std, bounds=bounds, recording=recording)


def _tuning(found: Mapping[int, JointFindings], config: ControllerConfig) -> JointTuning:
    """The configured gains, lowered where a joint's lag leaves less than the stated margins."""
    control = config.joint_control
    tau = control.pt1_time_constant_ms * 1e-3
    gains = list(control.gain_1_s)
    for joint, one in found.items():
        filtered = tau if joint in (1, 2) else 0.0
        gains[joint] = gain_within(gains[joint], one.lag.value + 2.0 * one.lag.std, filtered, MARGINS)
    a, b, c, d, e, f = gains
    return JointTuning(gain_1_s=(a, b, c, d, e, f))
