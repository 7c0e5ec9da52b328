"""Deadband, hysteresis, lag and flow of one valve edge from ramps and steps; pure functions.

Above the deadband's rim c the joint moves with dq/dt = g e f(u − c) − κ dp/dt − α da/dt, f(x) = x + k x²: g
is the true flow over the nominal one, e the nominal speed at full opening at the measured pressures, u the
spool, p the pressure of the chamber that is filled, κ its oil's compliance and a(p) how far the air in it is
compressed. Integrated once, every unknown is a factor of a measured signal: encoders are not differentiated,
and the oil that fills the chambers instead of moving the load is not taken for deadband.

On its way up the spool lags behind its command by half the hysteresis h and by the delay τ, on its way down
it leads by the first: c_rising = d + h/2 + ρ τ, c_falling = d − h/2 − ρ τ at the ramp's rate ρ: ``loop_fit``.

A load that runs ahead of its oil empties the chamber behind it as fast as the *outlet* edge lets it, while
the other one is filled from the tank: then e and p are the outlet's, and so is the deadband. Otherwise a
joint moves from the edge on that opens last: ``return_edge``. A load that is nearly balanced runs ahead at
small openings and has to be pushed at greater ones, within one ramp: each reading is fitted by the rows in
which it holds. An outlet that has a few bar left is no longer turbulent, e ∝ √(Δp / √(1 + (δ/Δp)²)): δ is
found along.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from controller.core.excitation.plan import StrokeKind
from protocol.errors import MeasurementFailed
from testbed.commissioning.ramp_fit import Floor, Loop, fit_flowing, loop_of
from testbed.commissioning.ramp_rows import FED_BAR, SLOW, Uncertain, smoothed_speed
from testbed.commissioning.recording import StrokeRecord, air_compressed
from testbed.commissioning.return_edge import METERS_RAD, between, holds_back, meets, return_edge

_LAMINAR_BAR = 8.0  # the most at which an edge's flow may turn from laminar to turbulent
_MOSTLY, _PARTLY = 0.5, 0.05  # of the ramps' motion, in which the load runs ahead
# What repeating does not average out: leakage past the spool and the orifice's laminar part shift the rim of
# a flow that depends on the load, the more so in drawn oil. [M] four joints each of 72902 to 72922.
_DEPENDENT, _COMPENSATED = Floor(8.0e-5, 2.0e-5), Floor(2.2e-5, 1.0e-5)
# A joint that leaves more is not the model's: three digits of an encoder whose rounding leaves a third,
# 0.02 mrad, as do booms that load-holding valves let down by fits and starts. With the slowest valve, 0.25
# rad/s a spool, over 5 s of ramp it stands for 1.2e-4 of spool: not 5 % of the smallest deadband, 0.3 %.
UNLIKE_RAD = 1.5e-4
_IMPLAUSIBLE = 3.0  # of the flow's curvature: progressive notches have 0.7
_POOR = 1e-3  # of spool: a fit that knows a deadband no better has not seen its edge


class EdgeFindings(NamedTuple):
    """One sense of one valve.

    ``deadband``, ``hysteresis``: of the spool. ``lag`` (s): from a slowly changing command to the flow.
    ``gain``: true flow over nominal where the valve opens; ``curvature`` k of the flow, f(x) = x + k x².
    ``residual`` (rad): rms of the ramps.

    ``deadband`` is that of the edge from which on the joint moves, ``last``: ``outlet`` where the load ran
    ahead of its oil, so that the edge that lets it out meters alone; else the one that opens last, ``supply``
    or ``return``, or ``unknown`` where one edge alone was seen: then the spread covers where the other may
    be. ``gap``: how far the supply edge opened before it, ``meets``: how far beyond it the supply edge
    meters; gain and curvature are those of the supply edge from where it opens.
    """

    deadband: Uncertain
    hysteresis: Uncertain
    lag: Uncertain
    gain: Uncertain
    curvature: float
    residual: float
    last: Literal["supply", "return", "outlet", "unknown"] = "supply"
    gap: float = 0.0
    meets: float = 0.0

    @property
    def by_outlet(self) -> bool:
        """Whether the load ran ahead of its oil."""
        return self.last == "outlet"


def edge_findings(strokes: Sequence[StrokeRecord], sense: float) -> EdgeFindings:
    """What the strokes of one sense say. Raises MeasurementFailed where they say too little.

    The filling edge tells, unless the load runs ahead of its oil: then the outlet edge does, also where so
    much of the ramps is ahead that what is left says too little.
    """
    mine = [stroke for stroke in strokes if stroke.sense == sense]
    ahead = _runs_ahead(mine)
    if ahead > _MOSTLY:
        return _by_outlet(mine)
    try:
        return _with_return_edge(_edge_findings(mine), mine)
    except MeasurementFailed:
        if ahead < _PARTLY:
            raise
        return _by_outlet(mine)


def _with_return_edge(supply: EdgeFindings, strokes: Sequence[StrokeRecord]) -> EdgeFindings:
    """``supply`` with the deadband of the return edge, where that one opens later.

    Where it meters on most of the ramps the supply edge's fit is poor, and the outlet's tells all.
    """
    triangles = _full_triangles(strokes)
    poor = supply.residual > UNLIKE_RAD or abs(supply.curvature) > _IMPLAUSIBLE or supply.deadband.std > _POOR
    if poor and (alone := _outlet_alone(strokes, 0.0)).residual < min(supply.residual, METERS_RAD):
        return alone._replace(last="return")
    loop = Loop(supply.deadband, supply.hysteresis, supply.lag)
    found = return_edge(triangles, loop, supply.curvature)
    if found is None:
        if not holds_back(triangles):
            return supply
        return supply._replace(deadband=between(triangles, loop), last="unknown")
    gap = found.opens.value - supply.deadband.value
    if gap <= 0.0:
        return supply
    return supply._replace(
        deadband=found.opens, last="return", gap=gap, meets=meets(gap, found, supply.gain.value)
    )


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
    """The findings by the outlet edge of a load that runs ahead of its oil."""

    def left(laminar_bar: float) -> float:
        return _edge_findings([_emptying(stroke, laminar_bar) for stroke in strokes]).residual

    best = minimize_scalar(left, bounds=(0.0, _LAMINAR_BAR), method="bounded", options={"xatol": 0.2})
    return _outlet_alone(strokes, float(best.x))._replace(last="outlet")


def _outlet_alone(strokes: Sequence[StrokeRecord], laminar_bar: float) -> EdgeFindings:
    """The findings by the outlet edge; its gain over the inlet's nominal speed, as the others'."""
    emptied = [_emptying(stroke, laminar_bar) for stroke in strokes]
    findings = _edge_findings(emptied)
    shares = [np.median(stroke.e / was.e) for stroke, was in zip(emptied, strokes, strict=True)]
    share = float(np.mean(shares))
    return findings._replace(gain=Uncertain(share * findings.gain.value, share * findings.gain.std))


def _emptying(stroke: StrokeRecord, laminar_bar: float) -> StrokeRecord:
    """``stroke`` read by its outlet, whose flow is laminar far below ``laminar_bar``."""
    back = stroke.inlet - stroke.fed_bar
    drop = np.maximum(stroke.outlet - back, 1e-9)
    e = stroke.e_by_outlet * np.sqrt(drop / np.hypot(drop, laminar_bar))
    return stroke._replace(
        e=e, inlet=-stroke.outlet, fed_bar=stroke.outlet - back, air=-air_compressed(stroke.outlet)
    )


def _edge_findings(strokes: Sequence[StrokeRecord]) -> EdgeFindings:
    triangles = _full_triangles(strokes)
    steps = [stroke for stroke in strokes if stroke.kind is StrokeKind.STEP]
    if len(triangles) < 2 or len(steps) < 2:
        why = f"{len(triangles)} full ramps and {len(steps)} steps: two of each are wanted"
        raise MeasurementFailed("measurement.too_few_strokes", why)
    ramps = fit_flowing(triangles, steps)
    floor = _COMPENSATED if all(s.compensated for s in strokes) else _DEPENDENT
    loop = loop_of(ramps, floor)
    return EdgeFindings(
        deadband=loop.deadband,
        hysteresis=loop.hysteresis,
        lag=loop.lag,
        gain=ramps.gain,
        curvature=ramps.curvature,
        residual=ramps.residual,
    )
