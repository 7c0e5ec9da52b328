"""The probability and the ellipse that are told, against drawn errors."""

import math

import numpy as np
import pytest

from vision_pc.core.positioning.expected_end import (
    ellipse_level,
    expected_end,
    probability_inside,
)

SPREAD = 1e-6 * np.array([[9.0, -3.0, 0.0], [-3.0, 4.0, 0.0], [0.0, 0.0, 25.0]])
MEAN = np.array([2e-3, -1e-3, 4e-3])


def drawn(freedom: float, count: int = 200_000) -> np.ndarray:
    """Errors (n, 2) of that covariance."""
    rng = np.random.default_rng(5)
    normal = rng.multivariate_normal(np.zeros(2), SPREAD[:2, :2], count)
    if math.isfinite(freedom):
        normal *= np.sqrt((freedom - 2.0) / rng.chisquare(freedom, count))[:, None]
    return np.asarray(MEAN[:2] + normal)


@pytest.mark.parametrize("freedom", [3.0, 6.0, math.inf])
def test_probability_and_ellipse_are_those_of_drawn_errors(freedom: float) -> None:
    errors = drawn(freedom)
    share = np.mean(np.abs(errors).max(axis=1) <= 5e-3)
    assert probability_inside(MEAN[:2], SPREAD[:2, :2], 5e-3, freedom) == pytest.approx(share, abs=0.004)
    off = errors - MEAN[:2]
    distance = np.einsum("ni,ni->n", off, np.linalg.solve(SPREAD[:2, :2], off.T).T)
    assert np.mean(distance <= ellipse_level(freedom)) == pytest.approx(0.95, abs=0.003)


def test_the_ellipse_lies_as_the_errors_do() -> None:
    end = expected_end(MEAN, SPREAD, 5e-3)
    major, minor, angle = end.ellipse
    along = np.array([math.cos(angle), math.sin(angle)])
    level = ellipse_level(math.inf)
    assert along @ SPREAD[:2, :2] @ along * level == pytest.approx(major**2)
    assert major * minor == pytest.approx(level * math.sqrt(np.linalg.det(SPREAD[:2, :2])))
    assert end.correlation == pytest.approx(-0.5)


def test_what_is_known_exactly_is_certain() -> None:
    tight = 1e-12 * np.eye(3)
    assert expected_end(np.zeros(3), tight, 5e-3).inside == pytest.approx(1.0)
    assert expected_end(np.array([6e-3, 0.0, 0.0]), tight, 5e-3).inside == 0.0
    assert expected_end(np.array([0.0, 6e-3, 0.0]), tight, 5e-3).inside == pytest.approx(0.0)


@pytest.mark.parametrize("freedom", [38.0, math.inf])
def test_a_probability_never_passes_one(freedom: float) -> None:
    """Sums of its nodes do, by a rounding, for some spreads."""
    tight = [std * std * np.eye(2) for std in np.linspace(2e-4, 9e-4, 40)]
    told = [probability_inside(np.array([8e-5, -6e-5]), spread, 5e-3, freedom) for spread in tight]
    assert max(told) <= 1.0
    assert min(told) > 0.99
