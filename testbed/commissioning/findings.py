"""What commissioning found of one joint, judged, and of all of them as commissioned.yaml."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from controller.commissioning import basis_of
from controller.config import ControllerConfig
from nominal_arm.commissioned import (
    Commissioned,
    JointTuning,
    JointValve,
    MeasuredNumber,
    ValveEdge,
    ValveSet,
)
from nominal_arm.description import JOINT_NAMES, NominalArm
from protocol.errors import MeasurementFailed
from testbed.commissioning.ramp_rows import Uncertain, midway
from testbed.commissioning.recording import JointRecording, StrokeRecord, strokes_in
from testbed.commissioning.valve_fit import UNLIKE_RAD, EdgeFindings, edge_findings

_SENSES = {1.0: "raising", -1.0: "lowering"}
_LEAST_MARGINS = ((math.radians(50.0), 1.0), (0.0, 3.0))  # of phase; of gain: how often it fits in
_LEAST_LAG_S = 1e-6


def greatest_gain(lag_s: float, pt1_s: float) -> float:
    """The greatest k (1/s) of L(s) = k e^(−s τ) / (s (1 + s T)) that leaves 50° of phase margin and a factor
    3 of gain margin: at each phase |L| = k / (ω √(1 + ω² T²)) may reach 1 over the factor.
    """
    lag_s = max(lag_s, _LEAST_LAG_S)
    gains = []
    for margin, factor in _LEAST_MARGINS:
        left = 0.5 * math.pi - margin  # of phase, beside the integrator's
        omega = brentq(lambda w, left=left: w * lag_s + math.atan(w * pt1_s) - left, 0.0, 2.0 * left / lag_s)
        gains.append(omega * math.hypot(1.0, omega * pt1_s) / factor)
    return min(gains)


DEADBAND_MOST = 0.3  # what the compensation can hold
_GAINS = (0.05, 20.0)
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
    """One joint. ``opened``: the greatest spool beyond the deadband, raising and lowering."""

    joint: int
    raising: EdgeFindings
    lowering: EdgeFindings
    opened: tuple[float, float]

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
    opened = [
        max((s.u.max() for s in strokes if s.sense == sense), default=0.0) - edge.deadband.value
        for sense, edge in ((1.0, raising), (-1.0, lowering))
    ]
    return JointFindings(recording.joint, raising, lowering, (float(opened[0]), float(opened[1])))


def _of_sense(joint: int, strokes: Sequence[StrokeRecord], sense: float) -> EdgeFindings:
    """``edge_findings``, judged; a refusal names the joint and its sense."""
    try:
        return _judged(edge_findings(strokes, sense))
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


def _judged(edge: EdgeFindings) -> EdgeFindings:
    """``edge``, if it can be used. Raises MeasurementFailed."""
    gain, deadband, std = edge.gain.value, edge.deadband.value, edge.deadband.std
    low, high = _GAINS
    left = f"the model leaves {1e3 * edge.residual:.2f} mrad, limit {1e3 * UNLIKE_RAD:g} mrad"
    open_ = f"deadband {deadband:.4f} ± {std:.4f} is below 0: the valve is open at its centre"
    for is_wrong, cause, why in (
        (edge.residual > UNLIKE_RAD, "unlike_model", left),
        (deadband + std >= DEADBAND_MOST, "at_bound", f"deadband {deadband:.4f}, limit {DEADBAND_MOST:g}"),
        (deadband < -4.0 * std, "unlike_model", open_),
        (not low < gain < high, "at_bound", f"flow over nominal {gain:.3g}, limits {low:g} and {high:g}"),
    ):
        if is_wrong:
            raise MeasurementFailed(f"measurement.{cause}", why)
    return edge


def commissioned_from(
    found: Mapping[int, JointFindings],
    arm: NominalArm,
    config: ControllerConfig,
    recordings: Mapping[int, str],
    made: tuple[str, str],
) -> Commissioned:
    """commissioned.yaml's content: what was ``found`` in place of what ``config`` believed.

    ``recordings``: what each joint's numbers came from. ``made``: when (UTC) and by what.
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
    )


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
        gains[joint] = min(gains[joint], greatest_gain(one.lag.value + 2.0 * one.lag.std, filtered))
    a, b, c, d, e, f = gains
    return JointTuning(gain_1_s=(a, b, c, d, e, f))
