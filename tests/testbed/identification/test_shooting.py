"""Shooting on a model of two numbers, whose covariance is known in closed form."""

from typing import Any

import numpy as np
import pytest

from testbed.identification import shooting
from testbed.identification.parameters import Parameter
from testbed.identification.shooting import DAMPINGS, FitProblem, Plan, shoot

N = 400
ALONG, ACROSS = np.linspace(-1.0, 1.0, N), np.linspace(-1.0, 1.0, N) ** 2 - 1.0 / 3.0
TOLD, HARDLY, CURVED = 200.0, 25.0, 1e4  # by their sum, by their difference, by the square of one of them


@pytest.fixture
def two_numbers(monkeypatch: pytest.MonkeyPatch) -> FitProblem:
    def model(_problem: Any, _window_s: float, theta: np.ndarray) -> np.ndarray:
        told = TOLD * (theta[0] + theta[1]) * ALONG
        return (told + (HARDLY * (theta[0] - theta[1]) + CURVED * theta[0] ** 2) * ACROSS)[:, None]

    monkeypatch.setattr(shooting, "signals", model)
    monkeypatch.setattr(shooting, "measured", lambda _recording: np.zeros((N, 1)))
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
