"""How much gain a joint's loop bears: an integrating joint behind a lag and the PT-1 element."""

import cmath
import math
from typing import NamedTuple


class Margins(NamedTuple):
    """Least phase margin (rad), and how often the gain fits in before the loop swings."""

    phase: float
    gain: float


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
