"""Quintic polynomials: end conditions exact, rest to rest is 10-15-6."""

import sys

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from controller.core.trajectories.paths import coefficients, evaluate

_numbers = st.floats(-5.0, 5.0)
_ends = st.tuples(_numbers, _numbers, _numbers).map(np.array)


@settings(deadline=None)  # the first call compiles
@example(start=np.array([0.0, 0.0, 5e-324]), end=np.zeros(3), duration=1.0)
@given(start=_ends, end=_ends, duration=st.floats(0.05, 60.0))
def test_end_conditions_are_met(start: np.ndarray, end: np.ndarray, duration: float) -> None:
    c = coefficients(start, end, duration)
    scale = max(np.abs(start).max(), np.abs(end).max(), 1e-3) * max(1.0, duration**2) * max(1.0, duration**-2)
    # The acceleration is halved and doubled: exact, unless half of it is too small for all of its bits.
    assert evaluate(c, 0.0) == pytest.approx(start, abs=2.0 * sys.float_info.min)
    assert evaluate(c, duration) == pytest.approx(end, abs=1e-12 * scale)


def test_the_smallest_number_may_be_lost_and_nothing_else_changes() -> None:
    start = np.array([1.0, 2.0, 5e-324])
    assert evaluate(coefficients(start, start, 1.0), 0.0) == (1.0, 2.0, 0.0)


def test_rest_to_rest_is_the_10_15_6_polynomial() -> None:
    c = coefficients(np.zeros(3), np.array([1.0, 0.0, 0.0]), 2.0)
    for s in np.linspace(0.0, 1.0, 21):
        assert evaluate(c, 2.0 * s)[0] == pytest.approx(10 * s**3 - 15 * s**4 + 6 * s**5, abs=1e-14)
    assert evaluate(c, 1.0)[1] == pytest.approx(1.875 / 2.0)


def test_jerk_from_rest_to_rest_is_what_the_documentation_says() -> None:
    c = coefficients(np.zeros(3), np.array([0.3, 0.0, 0.0]), 2.0)
    jerk = np.polynomial.Polynomial(c).deriv(3)(np.linspace(0.0, 2.0, 2001))
    bend = [evaluate(c, t)[2] for t in np.linspace(0.0, 2.0, 2001)]
    assert np.abs(jerk).max() == pytest.approx(60.0 * 0.3 / 2.0**3)
    assert np.abs(bend).max() == pytest.approx(10.0 / np.sqrt(3.0) * 0.3 / 2.0**2, rel=1e-5)


def test_derivatives_equal_numpy() -> None:
    c = np.array([0.3, -1.2, 0.7, 2.0, -0.4, 0.05])
    p = np.polynomial.Polynomial(c)
    for t in (0.0, 0.4, 1.7):
        assert evaluate(c, t) == pytest.approx((p(t), p.deriv()(t), p.deriv(2)(t)))
