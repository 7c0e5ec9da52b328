"""Shooting on a model of two numbers, whose covariance is known in closed form."""

from typing import Any

import numpy as np
import pytest

from testbed.identification import shooting
from testbed.identification.parameters import Parameter
from testbed.identification.shooting import DAMPINGS, FitProblem, Plan, shoot
from testbed.identification.validation import MOST_PROMISED

N = 400
ALONG, ACROSS = np.linspace(-1.0, 1.0, N), np.linspace(-1.0, 1.0, N) ** 2 - 1.0 / 3.0
TOLD, HARDLY, CURVED = 200.0, 25.0, 1e4  # by their sum, by their difference, by the square of one of them


def _straight(_problem: Any, _window_s: float, theta: np.ndarray) -> np.ndarray:
    told = TOLD * (theta[0] + theta[1]) * ALONG
    return np.asarray((told + HARDLY * (theta[0] - theta[1]) * ACROSS)[:, None])


def _put(monkeypatch: pytest.MonkeyPatch, model: Any, measured: np.ndarray) -> None:
    """Let ``model`` stand for the plant, and ``measured`` (N,) for what a recording told."""
    monkeypatch.setattr(shooting, "signals", model)
    monkeypatch.setattr(shooting, "measured", lambda _recording: measured[:, None])


@pytest.fixture
def two_numbers(monkeypatch: pytest.MonkeyPatch) -> FitProblem:
    def model(fitted: Any, window_s: float, theta: np.ndarray) -> np.ndarray:
        return np.asarray(_straight(fitted, window_s, theta) + CURVED * theta[0] ** 2 * ACROSS[:, None])

    _put(monkeypatch, model, np.zeros(N))
    both = tuple(Parameter(name, "", "offset", (), 1.0, "") for name in ("one", "other"))
    nothing: Any = None
    return FitProblem({}, both, nothing, nothing, nothing, (0,), np.ones(1))


def test_what_curves_tells_nothing_apart_once_differences_are_fine(two_numbers: FitProblem) -> None:
    plan = Plan(0.0, 1, 1, DAMPINGS, 1e-6, frozenset())
    columns = np.column_stack([TOLD * ALONG + HARDLY * ACROSS, TOLD * ALONG - HARDLY * ACROSS])
    true = np.sqrt(np.diag(np.linalg.inv(columns.T @ columns + np.eye(2))))
    coarse = shoot(two_numbers, np.zeros(2), plan)
    fine = shoot(two_numbers, np.zeros(2), plan, near=coarse)
    assert np.all(np.sqrt(np.diag(coarse.covariance)) < 0.5 * true)
    np.testing.assert_allclose(np.sqrt(np.diag(fine.covariance)), true, rtol=0.1)


def test_a_fit_goes_on_past_a_number_at_its_bound(
    two_numbers: FitProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut off at the bound of one number, the whole step promised nothing and was the last one."""
    measured = TOLD * ALONG + 2.0 * HARDLY * ACROSS  # by one = 1.5, other = −0.5
    _put(monkeypatch, _straight, measured)
    one, other = two_numbers.parameters
    bounded = two_numbers._replace(parameters=(one._replace(most=0.2), other))
    fit = shoot(bounded, np.zeros(2), Plan(0.0, 6, 3, DAMPINGS, 1e-6, frozenset()))
    assert fit.theta[0] == 0.2
    columns = np.column_stack([TOLD * ALONG + HARDLY * ACROSS, TOLD * ALONG - HARDLY * ACROSS])
    left = measured - columns[:, 0] * 0.2
    best = columns[:, 1] @ left / (columns[:, 1] @ columns[:, 1] + 1.0)
    assert fit.theta[1] == pytest.approx(best, abs=1e-6)
    assert fit.promised == pytest.approx(0.0, abs=1e-6)


def test_a_curved_valley_is_followed_to_its_end(
    two_numbers: FitProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps along tangents creep there, so that fits ran out of steps and were taken for finished ones."""
    curved, begin = _valley(two_numbers, monkeypatch), np.array([-2.0, 4.0])
    fit = shoot(curved, begin, Plan(0.0, 6, 3, DAMPINGS, 1e-6, frozenset()))
    np.testing.assert_allclose(fit.theta, [2.0, 4.0], atol=1e-3)
    assert fit.promised < 0.01 * MOST_PROMISED


def test_a_fit_that_is_broken_off_says_so(two_numbers: FitProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    curved, begin = _valley(two_numbers, monkeypatch), np.array([-2.0, 4.0])
    fit = shoot(curved, begin, Plan(0.0, 1, 1, DAMPINGS[3:], 1e-6, frozenset()))
    assert fit.cost > 1e3
    assert fit.promised == pytest.approx(fit.cost, rel=0.01)  # its prior is all that is left at the end


def _valley(two_numbers: FitProblem, monkeypatch: pytest.MonkeyPatch) -> FitProblem:
    """Along a parabola that the data tell well, from (−2, 4) to the one place that they tell, (2, 4)."""

    def valley(_problem: Any, _window_s: float, theta: np.ndarray) -> np.ndarray:
        return np.asarray((TOLD * (theta[1] - theta[0] ** 2) * ALONG + HARDLY * theta[0] * ACROSS)[:, None])

    _put(monkeypatch, valley, 2.0 * HARDLY * ACROSS)
    return two_numbers._replace(parameters=tuple(p._replace(spread=10.0) for p in two_numbers.parameters))
