"""The rims of one valve edge, its flow and its oil's compliance from triangles and steps; pure.

Integrated once, dq/dt = g e f(u − c) − κ dp/dt − α da/dt is linear in all but the rims c: they alone are
sought. a(p) is how far air in the oil is compressed: a slew's chambers stand a few bar above the tank, where
it makes the oil softer by a third, and what it swallows while a ramp rises would be taken for deadband.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from protocol.errors import MeasurementFailed
from testbed.commissioning.ramp_rows import Half, Uncertain, halves_of, plateaus, rate_of
from testbed.commissioning.recording import Array, StrokeRecord

_OPENING = 0.3  # of the rising ramp, in which the valve may still be closed
_SHARED = 4  # unknowns of all parts, before an offset each
_GAIN_FLOOR = 0.01
_CURVATURE_STD = 1.0  # prior of the flow's curvature: progressive notches have 0.7
_AIR_BAR = 80.0  # prior of what air makes of the compliance: 1 % of air in oil that is as stiff as 8000 bar
NOISE_RAD = 2.0e-5  # of an encoder reading


class _Part(NamedTuple):
    """Rows of a stroke in motion, and the weights of the rims whose sum holds there."""

    stroke: StrokeRecord
    rows: NDArray[np.intp]
    weights: Array


class RampFits(NamedTuple):
    """All triangles of one sense. ``gain``: flow over nominal where the valve opens; ``curvature`` k of the
    flow, f(x) = x + k x²; ``compliance``: κ (rad/bar); ``residual`` (rad).

    One a half of a triangle, (m,): ``rims``, the spools where flow begins or ends; ``ways``, 1 where it
    begins, −1 where it ends; ``rates`` of the command (1/s); ``covariance`` (m, m) of the rims, as far as
    what is left is chance.
    """

    gain: Uncertain
    curvature: float
    compliance: float
    rims: Array
    ways: Array
    rates: Array
    covariance: Array
    residual: float


def fit_flowing(triangles: Sequence[StrokeRecord], steps: Sequence[StrokeRecord]) -> RampFits:
    """The fit by rows with flow, and where they are too few by rows in motion.

    A load that swings on its oil is quick and slow while the flow hardly changes, and rows that are sorted by
    its speed hold such in which the spool still stands in its hysteresis.
    """
    try:
        return fit_ramps(triangles, steps, _compliance(triangles))
    except MeasurementFailed:
        return fit_ramps(triangles, steps)


def _compliance(triangles: Sequence[StrokeRecord]) -> float:
    """The oil's compliance (rad/bar) without a valve's model: while a ramp rises, its flow has no swings."""
    found = []
    for stroke in triangles:
        rows = np.arange(round(_OPENING * stroke.top), stroke.top)
        x = np.linspace(-1.0, 1.0, len(rows))
        matrix = np.column_stack([x**k for k in range(4)] + [stroke.inlet[rows[0]] - stroke.inlet[rows]])
        units = np.maximum(np.abs(matrix).max(axis=0), 1e-12)
        solved, *_ = np.linalg.lstsq(matrix / units, stroke.turned[rows], rcond=None)
        found.append(float(solved[-1] / units[-1]))
    return max(float(np.median(found)), 0.0)


def fit_ramps(
    triangles: Sequence[StrokeRecord],
    steps: Sequence[StrokeRecord] = (),
    compliance: float = 0.0,
) -> RampFits:
    """The RampFits of one sense's triangles: one gain, curvature, compliance and share of air, two rims each.

    ``steps`` reach further open than triangles: they tell the curvature.
    ``compliance`` (rad/bar) sorts rows by the flow that it makes of speed and pressure; 0: by the speed.

    Given the rims, all else is linear: they alone are sought, by Gauss-Newton. Raises MeasurementFailed when
    too little of a triangle moved, or when flow over nominal is not positive.
    """
    halves = halves_of(triangles, compliance)
    ways, rates = np.array([half.way for half in halves]), np.array([rate_of(half.stroke) for half in halves])
    parts = [
        _Part(half.stroke, rows, own)
        for half, own in zip(halves, np.eye(len(halves)), strict=True)
        for rows in half.runs
    ]
    count = sum(len(part.rows) for part in parts)
    outward = np.zeros(len(halves))
    outward[ways > 0.0] = _at_rest(rates[ways > 0.0])
    parts += [_Part(step, rows, outward) for step in steps for rows in plateaus(step)]
    airy = _AIR_BAR * _compliance(triangles)
    rims, jacobian = _rims(parts, halves, np.column_stack([np.ones_like(ways), ways, ways * rates]), airy)
    left, found = _misfit(parts, rims, airy)
    if not found[0] > 0.0:
        raise MeasurementFailed(
            "measurement.ramp_unlike_model", f"flow over nominal is {found[0]:.3g}, wanted > 0"
        )
    residual = float(np.sqrt(np.mean(left[:count] ** 2)))
    return RampFits(
        gain=Uncertain(float(found[0]), _GAIN_FLOOR * float(found[0])),
        curvature=float(found[1] / found[0]),
        compliance=float(found[2]),
        rims=rims,
        ways=ways,
        rates=rates,
        covariance=np.asarray(np.linalg.pinv(jacobian.T @ jacobian) * residual**2),
        residual=residual,
    )


def _rims(parts: Sequence[_Part], halves: Sequence[Half], tied: Array, airy: float) -> tuple[Array, Array]:
    """The rims (m,) that leave the least, and the derivatives of what is left; ``tied`` (m, 3): by what few
    numbers rims of one valve go together."""

    def left_at(rims: Array) -> Array:
        return _misfit(parts, rims, airy)[0]

    def left_by(few: Array) -> Array:
        return left_at(tied @ few)

    # From where rows begin, a short half may end beyond all its rows, where no flow says which way is back.
    seen = np.array([min(half.stroke.u[rows].min() for rows in half.runs) for half in halves])
    together = least_squares(left_by, np.linalg.pinv(tied) @ seen, x_scale=1e-3, method="lm")
    fits = [least_squares(left_at, start, x_scale=1e-3, method="lm") for start in (seen, tied @ together.x)]
    fit = min(fits, key=lambda one: float(one.cost))
    return np.asarray(fit.x), np.asarray(fit.jac)


def _misfit(parts: Sequence[_Part], rims: Array, airy: float) -> tuple[Array, Array]:
    """What the best linear fit at these rims leaves (rad), and its gain, gain · curvature, κ, α, and offsets.

    ``airy``: prior of α (rad); where it is 0, or no ``air`` is told, α is 0.
    """
    blocks, targets = [], []
    for k, (stroke, rows, weights) in enumerate(parts):
        beyond = np.maximum(stroke.u[rows] - weights @ rims, 0.0)
        block = np.zeros((len(rows), _SHARED + len(parts)))
        block[:, 0] = integral(stroke.t[rows], stroke.e[rows] * beyond)
        block[:, 1] = integral(stroke.t[rows], stroke.e[rows] * beyond**2)
        block[:, 2] = -(stroke.inlet[rows] - stroke.inlet[rows[0]])
        block[:, 3] = -(stroke.air[rows] - stroke.air[rows[0]]) if airy > 0.0 else 0.0
        block[:, _SHARED + k] = 1.0
        blocks.append(block)
        targets.append(stroke.turned[rows])
    prior = np.zeros((2, _SHARED + len(parts)))
    scale = max(float(np.abs(blocks[0][:, 0]).max()), 1e-9) / max(float(np.abs(targets[0]).max()), 1e-9)
    prior[0, 1] = NOISE_RAD * scale / _CURVATURE_STD
    prior[1, 3] = NOISE_RAD / airy if airy > 0.0 else 1.0
    matrix, wanted = np.vstack([*blocks, prior]), np.concatenate([*targets, np.zeros(len(prior))])
    units = np.maximum(np.abs(matrix).max(axis=0), 1e-12)
    solved, *_ = np.linalg.lstsq(matrix / units, wanted, rcond=None)
    return wanted - (matrix / units) @ solved, solved / units


def _at_rest(rates: Array) -> Array:
    """Weights with which the rims of rising ramps at these rates make that of a spool that has come out and
    stands: the lag's part grows with the rate, and is left out by a line through them."""
    if np.ptp(rates) < 0.2 * rates.mean():
        return np.full(len(rates), 1.0 / len(rates))
    matrix = np.column_stack([np.ones_like(rates), rates])
    return np.asarray(np.linalg.pinv(matrix)[0])


def integral(t: Array, values: Array) -> Array:
    """The integral (n,) from the first sample on, by trapezoids."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])


# Neighbouring rows err alike: a digit of an encoder stands for several scans of a slow ramp, and a model that
# is off by a few µrad is so for long. Times a rim's spread by white noise; [M] lifts and slews of 9201 to
# 9221: blocks of a quarter second scatter 1 to 2.3 times as much.
_ALIKE = 2.0
_RIM_STD = 3.0e-6  # of one rim, beyond what its rows' noise leaves
_PACES = 0.2  # of the mean rate: rates that differ by less are one


class Floor(NamedTuple):
    """Standard deviations (of spool) that all rims share, whatever their number."""

    deadband: float
    hysteresis: float


class Loop(NamedTuple):
    """``deadband``, ``hysteresis``: of the spool; ``lag`` (s): from a slowly changing command to the flow."""

    deadband: Uncertain
    hysteresis: Uncertain
    lag: Uncertain


def loop_of(ramps: RampFits, floor: Floor) -> Loop:
    """The Loop whose rims c = d ± (h/2 + ρ τ), + where flow begins, come closest to those of ``ramps``.

    Each rim counts as much as its rows tell of it, and all are told with the scatter that they have, where it
    is more than that. Raises MeasurementFailed (``measurement.one_pace``) where all rates ρ are alike.
    """
    if np.ptp(ramps.rates) < _PACES * ramps.rates.mean():
        raise MeasurementFailed(
            "measurement.one_pace", "all ramps have one pace: hysteresis and lag look alike"
        )
    matrix = np.column_stack([np.ones_like(ramps.rims), 0.5 * ramps.ways, ramps.ways * ramps.rates])
    covariance = _ALIKE**2 * ramps.covariance + _RIM_STD**2 * np.eye(len(ramps.rims))
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    found, *_ = np.linalg.lstsq(white @ matrix, white @ ramps.rims, rcond=None)
    left = white @ (ramps.rims - matrix @ found)
    free = len(left) - len(found)
    wider = max(float(left @ left) / free, 1.0) if free else 1.0
    spread = wider * np.linalg.inv(matrix.T @ np.linalg.inv(covariance) @ matrix)
    shared = (floor.deadband, floor.hysteresis, 0.0)
    stds = np.sqrt(np.diag(spread) + np.square(shared))
    return Loop(*(Uncertain(float(v), float(s)) for v, s in zip(found, stds, strict=True)))
