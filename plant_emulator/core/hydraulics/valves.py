"""Servo valve: spool dynamics, deadband and regularised turbulent orifices."""

import math

from foundation.compiled import allocation_free


@allocation_free
def opening(spool: float, deadband: float) -> float:
    """Effective opening −1…1: zero inside the deadband, rescaled so that full spool is full opening."""
    size = abs(spool) - deadband
    if size <= 0.0:
        return 0.0
    return math.copysign(size / (1.0 - deadband), spool)


@allocation_free
def orifice_flow(gain: float, drop: float, regularisation: float) -> float:
    """Turbulent flow (m³/s) through an edge of ``gain`` (m³/s/√Pa) at pressure ``drop`` (Pa).

    Odd and smooth: K Δp / (Δp² + δ²)^¼, which is K √Δp for Δp ≫ δ and laminar at zero.
    """
    return gain * drop / math.sqrt(math.sqrt(drop * drop + regularisation * regularisation))


@allocation_free
def spool_acceleration(command: float, spool: float, rate: float, natural: float, damping: float) -> float:
    """Second-order spool, ẍ = ω²(u − x) − 2ζω ẋ (1/s²)."""
    return natural * natural * (command - spool) - 2.0 * damping * natural * rate


@allocation_free
def slew_limited(previous: float, target: float, limit: float, h: float) -> tuple[float, float]:
    """The drive's command after ``h`` seconds on its way to ``target``, and its mean over that time.

    The electronics ramp at ``limit`` (1/s). A ramp may end inside the step: the mean carries its exact
    impulse, so that the spool's response does not depend on the step size to first order.
    """
    way = target - previous
    if abs(way) >= limit * h:
        ramp = math.copysign(limit * h, way)
        return previous + ramp, previous + 0.5 * ramp
    return target, target - 0.5 * way * abs(way) / (limit * h)


@allocation_free
def held_gain(release: float, hold: float, pilot: float, span: float) -> float:
    """Gain of a releasing edge in series with a counterbalance valve.

    The latter opens with ``pilot`` (Pa) above its setting, fully at ``span`` (Pa).

    Two turbulent edges in series pass what one of gain K1 K2 / √(K1² + K2²) would; a closed one holds the
    load.
    """
    if pilot <= 0.0 or release <= 0.0:
        return 0.0
    other = hold * min(pilot / span, 1.0)
    return release * other / math.sqrt(release * release + other * other)
