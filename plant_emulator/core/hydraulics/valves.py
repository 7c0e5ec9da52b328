"""Valves: spool dynamics, overlap, flow curve, regularised turbulent orifices, pressure compensators."""

import math

from foundation.compiled import allocation_free


@allocation_free
def opening(travel: float, overlap: float, slope: float) -> float:
    """Effective opening 0…1 of an edge at spool ``travel`` 0…1: zero up to the overlap, 1 at full travel.

    ``slope``: of this curve where the edge opens, over its mean; 1 makes it straight, less progressive.
    """
    size = travel - overlap
    if size <= 0.0:
        return 0.0
    share = size / (1.0 - overlap)
    return share * (slope + (1.0 - slope) * share)


@allocation_free
def orifice_flow(gain: float, drop: float, regularisation: float) -> float:
    """Turbulent flow (m³/s) through an edge of ``gain`` (m³/s/√Pa) at pressure ``drop`` (Pa).

    Odd and smooth: K Δp / (Δp² + δ²)^¼, which is K √Δp for Δp ≫ δ and laminar at zero.
    """
    return gain * drop / math.sqrt(math.sqrt(drop * drop + regularisation * regularisation))


@allocation_free
def compensated_drop(drop: float, kept: float) -> float:
    """What is left (Pa) across a metering edge of ``drop`` (Pa) from pump to load, by its compensator.

    The compensator, a valve in series before the edge, keeps ``kept`` (Pa) across it as long as there is that
    much: far above, the flow does not depend on the load; below, the valve is wide open and the edge alone
    counts. It also is a check valve: no oil goes back.
    """
    if drop <= 0.0:
        return 0.0
    ratio = drop / kept
    ratio *= ratio
    return drop / math.sqrt(math.sqrt(1.0 + ratio * ratio))


@allocation_free
def spool_acceleration(command: float, spool: float, rate: float, natural: float, damping: float) -> float:
    """Second-order spool, ẍ = ω²(u − x) − 2ζω ẋ (1/s²)."""
    return natural * natural * (command - spool) - 2.0 * damping * natural * rate


@allocation_free
def _ramped(previous: float, target: float, limit: float, h: float) -> tuple[float, float]:
    """The command after ``h`` seconds at ``limit`` (1/s) towards ``target``, and its mean until then."""
    way = target - previous
    if abs(way) >= limit * h:
        ramp = math.copysign(limit * h, way)
        return previous + ramp, previous + 0.5 * ramp
    return target, target - 0.5 * way * abs(way) / (limit * h)


@allocation_free
def slew_limited(previous: float, target: float, out: float, back: float, h: float) -> tuple[float, float]:
    """The spool's command after ``h`` seconds on its way to ``target``, and its mean over that time.

    It ramps at ``out`` (1/s) away from the centre, at ``back`` towards it. A ramp may end or pass the centre
    inside the step: the mean carries its exact impulse, so that the spool's response does not depend on the
    step size to first order.
    """
    if out == back:
        return _ramped(previous, target, out, h)
    if previous * target >= 0.0:
        return _ramped(previous, target, out if abs(target) > abs(previous) else back, h)
    until_centre = abs(previous) / back
    if until_centre >= h:
        return _ramped(previous, target, back, h)
    left = h - until_centre
    reached, mean = _ramped(0.0, target, out, left)
    return reached, (0.5 * previous * until_centre + mean * left) / h


@allocation_free
def held_gain(release: float, hold: float) -> float:
    """Gain of a releasing edge in series with a counterbalance valve of gain ``hold`` as it stands open.

    Two turbulent edges in series pass what one of gain K1 K2 / √(K1² + K2²) would; a closed one holds the
    load.
    """
    if hold <= 0.0 or release <= 0.0:
        return 0.0
    return release * hold / math.sqrt(release * release + hold * hold)
