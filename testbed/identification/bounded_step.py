"""A step of Gauss and Newton within bounds: where a quadratic has its minimum. Pure algebra."""

import numpy as np

from testbed.identification.recording import Array


def information_of_step(columns: Array, spreads: Array, damping: float = 0.0) -> Array:
    """JᵀJ + damping · diag JᵀJ + prior (f, f) for ``columns`` (m, f), in units of the priors' ``spreads``.

    Scaled so, it is well conditioned; Marquardt (1963) damps along its diagonal.
    """
    scaled = columns * spreads
    found = scaled.T @ scaled
    return np.asarray(found + np.diag(damping * np.diag(found) + 1.0))


def bounded_move(information: Array, downhill: Array, low: Array, high: Array) -> Array:
    """The move (f,) inside ``low`` to ``high`` that gains most of 2 xᵀ downhill − xᵀ information x.

    What would leave its bounds is put there, and the others are solved for again: they make up for it. A step
    that is merely cut off there goes on as if the one at its bound had moved, and may well lead uphill.
    """
    move, fixed = np.zeros(len(downhill)), np.zeros(len(downhill), dtype=bool)
    while not fixed.all():
        free = ~fixed
        asked = downhill[free] - information[np.ix_(free, fixed)] @ move[fixed]
        move[free] = np.linalg.solve(information[np.ix_(free, free)], asked)
        beyond = free & ((move < low) | (move > high))
        if not beyond.any():
            break
        move[beyond] = np.clip(move[beyond], low[beyond], high[beyond])
        fixed |= beyond
    return move
