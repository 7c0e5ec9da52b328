"""A step of Gauss and Newton within bounds, against SciPy's bounded least squares."""

import numpy as np
from scipy.optimize import lsq_linear

from testbed.identification.shooting import bounded_move, information_of_step

COLUMNS = np.array([[10.0, 9.5], [0.0, 1.0], [1.0, 0.0]])
ASKED = np.array([-12.0, 3.0, -3.0])
WIDE = np.full(2, 1e3)


def _gain(move: np.ndarray) -> float:
    """By how much χ² of data and prior falls from the origin to ``move``."""
    return float(ASKED @ ASKED - np.sum((ASKED - COLUMNS @ move) ** 2) - move @ move)


def test_what_a_bound_holds_back_the_others_make_up_for() -> None:
    """Two numbers that all but their sum confuses: cut off at the bound of one, the step goes uphill."""
    information, downhill = information_of_step(COLUMNS, np.ones(2)), COLUMNS.T @ ASKED
    low = np.array([-0.1, -1e3])
    cut_off = np.clip(np.linalg.solve(information, downhill), low, WIDE)
    move = bounded_move(information, downhill, low, WIDE)
    assert _gain(cut_off) < 0.0
    rows, told = np.vstack([COLUMNS, np.eye(2)]), np.concatenate([ASKED, np.zeros(2)])
    best = lsq_linear(rows, told, (low, WIDE)).x
    np.testing.assert_allclose(move, best, atol=1e-6)
    assert _gain(move) > 0.9 * _gain(best)
