"""Deadband, hysteresis, delay and flow of one valve edge from ramps and steps; pure functions.

Above the deadband's rim c the joint moves with dq/dt = g e f(u − c) − κ dp/dt, f(x) = x + k x²: g is the
true flow over the nominal one, e the nominal speed at full opening at the measured pressures, u the spool, p
the pressure of the chamber that is filled and κ its oil's compliance. Integrated once, every unknown is a
factor of a measured signal: encoders are not differentiated, and the oil that fills the chambers instead of
moving the load is not taken for deadband.

On its way up the spool lags behind its command by half the hysteresis h and by the delay τ, on its way down
it leads by the first: c_rising = d + h/2 + ρ τ, c_falling = d − h/2 − ρ τ at the ramp's rate ρ. So the mean
is the deadband d, whatever h and τ are.

A load that runs ahead of its oil empties the chamber behind it as fast as the *outlet* edge lets it, while
the other one is filled from the tank: then e and p are the outlet's, and so is the deadband. Return edges
open first, so that it is the smaller one. A load that is nearly balanced runs ahead at small openings and
has to be pushed at greater ones, within one ramp: each reading is fitted by the rows in which it holds. An
outlet that has a few bar left is no longer turbulent, e ∝ √(Δp / √(1 + (δ/Δp)²)): δ is found along.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from controller.core.excitation.plan import StrokeKind
from protocol.errors import MeasurementFailed
from testbed.commissioning.ramp_fit import (
    CLEARLY,
    FED_BAR,
    NOISE_RAD,
    SLOW,
    RampFits,
    fit_flowing,
    fit_step,
    smoothed_speed,
)
from testbed.commissioning.recording import StrokeRecord
from testbed.commissioning.uncertain import Uncertain, repeated

_LAMINAR_BAR = 8.0  # the most at which an edge's flow may turn from laminar to turbulent
_MOSTLY, _PARTLY = 0.5, 0.05  # of the ramps' motion, in which the load runs ahead
# Standard deviation of what repeating does not average out: leakage past the spool and the orifice's laminar
# part shift the rim, the other errors grow with the deadband, and with the square of what the model leaves: a
# load that swings on its load-holding valve. [M] 92 deadbands of drawn machines, 7400 to 7418.
_RIM_FLOOR, _RIM_SHARE = 4.2e-5, 0.00175
_DELAY_FLOOR_S = 0.003
_WIDTH_FLOOR, _WIDTH_SHARE = 8.0e-6, 6.0e-4  # of spool, of the rim; [M] one joint of each of 7500 to 7528


class EdgeFindings(NamedTuple):
    """One sense of one valve.

    ``deadband``, ``hysteresis``: of the spool. ``lag`` (s): from a slowly changing command to the flow;
    ``response`` (s): from a step to its flow. ``gain``: true flow over nominal where the valve opens;
    ``curvature`` k of the flow, f(x) = x + k x²; ``compliance`` (rad/bar): of the oil; ``flow``: (spool,
    speed over nominal at full spool) of every step. ``residual`` (rad): rms of the ramps. ``by_outlet``: the
    load ran ahead of its oil, and the deadband is that of the edge that lets it out.
    """

    deadband: Uncertain
    hysteresis: Uncertain
    lag: Uncertain
    response: Uncertain
    gain: Uncertain
    curvature: float
    compliance: float
    flow: tuple[tuple[float, float], ...]
    residual: float
    by_outlet: bool = False


def edge_findings(strokes: Sequence[StrokeRecord], sense: float) -> EdgeFindings:
    """What the strokes of one sense say. Raises MeasurementFailed where they say too little.

    Both readings of the pressures are tried: the filling edge alone, which holds for every valve, and four
    edges alike, which suffers less from air in the oil. The second is told where it leaves clearly less, and
    may say nothing. Where the load runs ahead neither holds, and the outlet edge is told; that also holds
    where it runs ahead in so much of the ramps that what is left says too little.
    """
    mine = [stroke for stroke in strokes if stroke.sense == sense]
    ahead = _runs_ahead(mine)
    if ahead > _MOSTLY:
        return _by_outlet(mine)
    alike = [stroke._replace(e=stroke.e_by_load, inlet=stroke.load) for stroke in mine]
    filling, why = _told(mine)
    all_four, _ = _told(alike)
    if (filling is None or all_four is None) and ahead >= _PARTLY:
        return _by_outlet(mine)
    if why is not None:
        raise why
    assert filling is not None
    if all_four is not None and all_four.residual * CLEARLY < filling.residual:
        return all_four
    return filling


def _told(strokes: Sequence[StrokeRecord]) -> tuple[EdgeFindings | None, MeasurementFailed | None]:
    """What one reading of the pressures says, or why it says nothing."""
    try:
        return _found(strokes), None
    except MeasurementFailed as error:
        return None, error


def _full_triangles(strokes: Sequence[StrokeRecord]) -> list[StrokeRecord]:
    return [stroke for stroke in strokes if stroke.kind is StrokeKind.RAMP][1:]  # one found the way


def _runs_ahead(strokes: Sequence[StrokeRecord]) -> float:
    """The share of the ramps' motion in which the chamber to be filled stands at the tank's pressure."""
    shares = []
    for stroke in _full_triangles(strokes):
        speed = smoothed_speed(stroke)
        shares.append(np.mean(stroke.fed_bar[speed > SLOW * speed.max()] < FED_BAR))
    return float(np.mean(shares)) if shares else 0.0


def _by_outlet(strokes: Sequence[StrokeRecord]) -> EdgeFindings:
    """The findings by the outlet edge; gain and flow over the inlet's nominal speed, as the others'."""

    def left(laminar_bar: float) -> float:
        return _found([_emptying(stroke, laminar_bar) for stroke in strokes]).residual

    best = minimize_scalar(left, bounds=(0.0, _LAMINAR_BAR), method="bounded", options={"xatol": 0.2})
    emptied = [_emptying(stroke, float(best.x)) for stroke in strokes]
    told = _found(emptied)
    shares = [np.median(stroke.e / was.e) for stroke, was in zip(emptied, strokes, strict=True)]
    share = float(np.mean(shares))
    return told._replace(
        gain=Uncertain(share * told.gain.value, share * told.gain.std),
        flow=tuple((spool, share * speed) for spool, speed in told.flow),
        by_outlet=True,
    )


def _emptying(stroke: StrokeRecord, laminar_bar: float) -> StrokeRecord:
    """``stroke`` read by its outlet, whose flow is laminar far below ``laminar_bar``."""
    back = stroke.inlet - stroke.fed_bar
    drop = np.maximum(stroke.outlet - back, 1e-9)
    e = stroke.e_by_outlet * np.sqrt(drop / np.hypot(drop, laminar_bar))
    return stroke._replace(e=e, inlet=-stroke.outlet, fed_bar=stroke.outlet - back)


def _found(strokes: Sequence[StrokeRecord]) -> EdgeFindings:
    triangles = _full_triangles(strokes)
    stepped = [stroke for stroke in strokes if stroke.kind is StrokeKind.STEP]
    steps = [fit_step(stroke) for stroke in stepped]
    if len(triangles) < 2 or len(steps) < 2:
        why = f"{len(triangles)} full ramps and {len(steps)} steps: two of each are wanted"
        raise MeasurementFailed("measurement.too_few_strokes", why)
    ramps = fit_flowing(triangles, [(s, fit.delay) for s, fit in zip(stepped, steps, strict=True)])
    middle = 0.5 * (ramps.rising + ramps.falling)
    residual = float(np.sqrt(np.mean(ramps.residual**2)))
    beyond = max(residual / NOISE_RAD, 1.0)  # what is left beyond the noise is the model's
    hysteresis, lag = _loop(ramps, beyond)
    floor = beyond**2 * math.hypot(_RIM_FLOOR, _RIM_SHARE * float(middle.mean()))
    return EdgeFindings(
        deadband=repeated(middle.tolist(), floor),
        hysteresis=hysteresis,
        lag=lag,
        response=repeated([step.delay for step in steps], _DELAY_FLOOR_S),
        gain=ramps.gain,
        curvature=ramps.curvature,
        compliance=ramps.compliance,
        flow=tuple((step.spool, step.relative_speed) for step in steps),
        residual=residual,
    )


def _loop(ramps: RampFits, beyond: float) -> tuple[Uncertain, Uncertain]:
    """Hysteresis (of spool) and lag (s): the loop's width is h + 2 ρ τ, at two rates ρ or more.

    ``beyond``: times the floor of the spread. What the floor stands for all widths share, whatever their
    rate: the hysteresis has it once, and reaching from two rates to rate 0 does not multiply it, as it does
    scatter.
    """
    width = ramps.rising - ramps.falling
    matrix = np.column_stack([np.ones_like(width), 2.0 * ramps.rate])
    if np.ptp(ramps.rate) < 0.2 * ramps.rate.mean():
        raise MeasurementFailed(
            "measurement.one_pace", "all ramps have one pace: hysteresis and lag look alike"
        )
    found, *_ = np.linalg.lstsq(matrix, width, rcond=None)
    floor = beyond * math.hypot(_WIDTH_FLOOR, _WIDTH_SHARE * float(ramps.rising.mean()))
    scatter = 2.0 * float(np.std(width - matrix @ found))
    reach = np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    hysteresis = Uncertain(float(found[0]), math.hypot(scatter * float(reach[0]), floor))
    return hysteresis, Uncertain(float(found[1]), math.hypot(scatter, floor) * float(reach[1]))
