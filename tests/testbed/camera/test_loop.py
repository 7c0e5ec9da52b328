"""`longreach camera loop`: what its figures are of."""

import numpy as np
import pytest

from testbed.camera.loop import LoopRow, likely_ratio, turned_error
from vision_pc.core import se3


def test_a_tool_that_is_where_vision_wants_it_has_no_error_in_its_axes() -> None:
    """In the raw left eye's axes it had 0.27 mm: that made the loop miss its 1.2 times."""
    R, clearance_mm = se3.exp_so3(np.radians([-0.157, -0.034, -0.003])), 100.0
    away = R.T @ [0.0, 0.0, clearance_mm]  # p_CO - p_CM in the raw axes
    raw = away - [0.0, 0.0, clearance_mm]
    assert np.linalg.norm(raw[:2]) == pytest.approx(0.28, abs=0.01)
    np.testing.assert_allclose(turned_error(raw, R, clearance_mm), 0.0, atol=1e-9)


def test_without_a_turn_an_error_is_what_it_was() -> None:
    np.testing.assert_allclose(turned_error(np.array([0.3, -0.2, 1.0]), np.eye(3), 100.0), [0.3, -0.2, 1.0])


def test_the_ratio_is_told_with_its_spread() -> None:
    rng = np.random.default_rng(3)
    perfect = rng.uniform(0.2, 0.8, 30)
    many = [LoopRow(k, 1.1 * value, value) for k, value in enumerate(perfect)]
    assert likely_ratio(many) == pytest.approx((1.1, 1.1))  # errors that go together have one ratio
    apart = [row._replace(raw_mm=float(value)) for row, value in zip(many, 1.1 * perfect[::-1], strict=True)]
    low, high = likely_ratio(apart)
    assert low < 1.0 < 1.2 < high
