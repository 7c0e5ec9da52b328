"""Quintic polynomials in time: six end conditions, six coefficients.

Source: Mäkinen et al. 2023, section on motion control; the general form for re-planning from a moving state.
"""

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.kinematics.triples import Vector
from foundation.compiled import kernel


@kernel
def coefficients(start: Array, end: Array, duration: float) -> Array:
    """Coefficients c (6,) of x(t) = Σ c_k t^k with ``start`` at 0 and ``end`` at ``duration`` (s).

    ``start`` and ``end`` are value, first and second derivative. From rest to rest: the 10-15-6 polynomial.
    """
    T = duration
    gap = end[0] - start[0] - start[1] * T - 0.5 * start[2] * T * T
    slope = (end[1] - start[1] - start[2] * T) * T
    bend = (end[2] - start[2]) * T * T
    return np.array(
        [
            start[0],
            start[1],
            0.5 * start[2],
            (10.0 * gap - 4.0 * slope + 0.5 * bend) / T**3,
            (-15.0 * gap + 7.0 * slope - bend) / T**4,
            (6.0 * gap - 3.0 * slope + 0.5 * bend) / T**5,
        ]
    )


@kernel
def evaluate(c: Vector, t: float) -> tuple[float, float, float]:
    """Value, first and second derivative at time ``t`` of the polynomial with coefficients ``c`` (6,)."""
    value = ((((c[5] * t + c[4]) * t + c[3]) * t + c[2]) * t + c[1]) * t + c[0]
    first = (((5.0 * c[5] * t + 4.0 * c[4]) * t + 3.0 * c[3]) * t + 2.0 * c[2]) * t + c[1]
    second = ((20.0 * c[5] * t + 12.0 * c[4]) * t + 6.0 * c[3]) * t + 2.0 * c[2]
    return value, first, second
