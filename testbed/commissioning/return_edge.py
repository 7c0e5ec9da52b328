"""Where the edge that lets oil out opens: on falling ramps, from the pressure of the emptied chamber; pure.

An actuator moves once both edges of a sense are open. The fit of the edge that fills goes on by its line as
far as that edge is closed, and passes the gap in which the other one still holds the oil back. The emptied
chamber has an equation of its own, dq/dt = g e f(u − c) + κ dp/dt with e and p of the outlet. It is asked of
slow rows alone, where the edge itself meters, not the load-holding valve in series with it, and on the way
down, where backlash is taken up and that valve stands open.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar, nnls

from protocol.errors import MeasurementFailed
from testbed.commissioning.ramp_fit import Loop, integral
from testbed.commissioning.ramp_rows import (
    SHORTEST_S,
    Uncertain,
    is_settled,
    rate_of,
    runs_of,
    smoothed_speed,
)
from testbed.commissioning.recording import Array, StrokeRecord

_SLOWEST, _FASTEST = 0.05, 0.5  # of a ramp's top speed: slower, and a swing crosses the backlash
_STEP = 5e-4  # of spool: a valley of the misfit is some times as wide
_REACH = 4e-3  # of spool, to either side, in which the edge is sought again without one of the ramps
METERS_RAD = 6.0e-5  # [M] of edges that meter 0.02 to 0.04 mrad, of holding valves that do 0.1 and more
_DEPENDENT, _COMPENSATED = 9.0e-5, 4.5e-5  # of spool: what leakage past it shifts in all ramps alike [M]
_RISES_BAR = 1.0  # of the filled chamber, over the slow rows of a ramp: more than its noise
_SHARES = (0.2, 1.0)  # of the gap, in which the flow of the return edge reaches that of the supply edge
_CURVED = 1.5  # a notch is not more progressive than that


class ReturnEdge(NamedTuple):
    """``opens``: the spool at which the outlet edge opens, middle of the loop; ``gain``: its flow over the
    nominal one at the nominal drop, ``drop``: root of the pressure across it over the nominal one."""

    opens: Uncertain
    gain: float
    drop: float


class _Run(NamedTuple):
    stroke: StrokeRecord
    rows: NDArray[np.intp]


def return_edge(triangles: Sequence[StrokeRecord], loop: Loop, curvature: float) -> ReturnEdge | None:
    """The ReturnEdge by the falling halves of ``triangles``; None where something else meters the outlet.

    ``loop``: hysteresis and lag of the same spool, by its other edge. ``curvature``: of its flow.
    """
    runs = [run for stroke in triangles for run in _slow_runs(stroke)]
    if len(runs) < 2:
        return None
    k = float(np.clip(curvature, -_CURVED, _CURVED))
    grid = np.arange(0.0, max(float(stroke.u.max()) for stroke in triangles), _STEP)
    at = _lowest(runs, loop, k, grid)
    residual, gain = _misfit(runs, at, loop, k)
    if residual > METERS_RAD or not gain > 0.0:
        return None
    near = np.arange(max(at - _REACH, 0.0), at + _REACH, _STEP)
    without = [[run for run in runs if run.stroke is not stroke] for stroke in triangles]
    scatter = _jackknife([_lowest(some, loop, k, near) for some in without if some])
    lag = float(np.mean([rate_of(run.stroke) for run in runs])) * loop.lag.std
    shared = _COMPENSATED if all(stroke.compensated for stroke in triangles) else _DEPENDENT
    std = math.hypot(scatter, 0.5 * loop.hysteresis.std, lag, shared)
    drops = [np.median(run.stroke.e_by_outlet[run.rows] / run.stroke.nominal[run.rows]) for run in runs]
    return ReturnEdge(Uncertain(at, std), gain, float(np.mean(drops)))


def holds_back(triangles: Sequence[StrokeRecord]) -> bool:
    """Whether the filled chamber's pressure rises while a ramp runs out: the outlet then closes first."""
    rises = [
        float(stroke.inlet[rows[-1]] - stroke.inlet[rows[0]])
        for stroke in triangles
        for _, rows in _slow_runs(stroke)[-1:]
    ]
    return bool(rises) and float(np.median(rises)) > _RISES_BAR


def between(triangles: Sequence[StrokeRecord], supply: Loop) -> Uncertain:
    """Where the joint begins to move, when all that is known of it is that it is not before the supply edge
    opens, nor after it is seen to move: the middle, and an even spread's standard deviation."""
    ends = []
    for stroke in triangles:
        for _, rows in _slow_runs(stroke)[:1]:
            ends.append(float(stroke.u[rows[0]]) + _ahead(stroke, supply))
    if not ends:
        raise MeasurementFailed("measurement.ramp_too_short", "no slow rows on the falling ramps")
    width = max(float(np.median(ends)) - supply.deadband.value, 0.0)
    std = float(np.hypot(width / np.sqrt(12.0), supply.deadband.std))
    return Uncertain(supply.deadband.value + 0.5 * width, std)


def meets(gap: float, found: ReturnEdge, gain: float) -> float:
    """By how far beyond the return edge (of spool) its flow reaches that of the supply edge, ``gap`` before
    it and of ``gain``: from there on the supply edge meters."""
    ratio = found.gain * found.drop / gain
    share = 1.0 / (ratio - 1.0) if ratio > 1.0 else _SHARES[1]
    return gap * float(np.clip(share, *_SHARES))


def _slow_runs(stroke: StrokeRecord) -> list[_Run]:
    speed = smoothed_speed(stroke)
    top = float(speed.max())
    slow = (np.arange(len(speed)) > stroke.top) & (speed > _SLOWEST * top) & (speed < _FASTEST * top)
    runs = runs_of(slow & is_settled(stroke))
    return [_Run(stroke, rows) for rows in runs if stroke.t[rows[-1]] - stroke.t[rows[0]] >= SHORTEST_S]


def _ahead(stroke: StrokeRecord, loop: Loop) -> float:
    """By how much a spool on its way back stands further open than its command."""
    return 0.5 * loop.hysteresis.value + rate_of(stroke) * loop.lag.value


def _jackknife(without: Sequence[float]) -> float:
    """The standard deviation of an estimate by what it is ``without`` each of n parts."""
    n = len(without)
    return math.sqrt((n - 1) ** 2 / n) * float(np.std(without, ddof=1)) if n > 1 else math.inf


def _lowest(runs: Sequence[_Run], loop: Loop, k: float, grid: Array) -> float:
    """The edge that leaves the least: the best of ``grid``, and what lies beside it."""

    def left(at: float) -> float:
        return _misfit(runs, at, loop, k)[0]

    best = float(grid[int(np.argmin([left(float(at)) for at in grid]))])
    found = minimize_scalar(
        left, bounds=(best - _STEP, best + _STEP), method="bounded", options={"xatol": 1e-6}
    )
    return float(found.x)


def _misfit(runs: Sequence[_Run], at: float, loop: Loop, k: float) -> tuple[float, float]:
    """What an edge ``at`` leaves (rad, rms), and its gain; as the oil's compliance, it is not below 0."""
    blocks, turned = [], []
    for stroke, rows in runs:
        x = np.maximum(stroke.u[rows] + _ahead(stroke, loop) - at, 0.0)
        passed = integral(stroke.t[rows], stroke.e_by_outlet[rows] * (x + k * x * x))
        columns = np.column_stack([passed, stroke.outlet[rows]])
        blocks.append(columns - columns.mean(axis=0))
        turned.append(stroke.turned[rows] - stroke.turned[rows].mean())
    matrix, travel = np.vstack(blocks), np.concatenate(turned)
    units = np.maximum(np.abs(matrix).max(axis=0), 1e-12)
    found, residual = nnls(matrix / units, travel)
    return float(residual) / math.sqrt(len(travel)), float(found[0] / units[0])
