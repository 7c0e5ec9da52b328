"""What a recording does not tell keeps the file's number, and all that is reported is as sure as it says."""

import numpy as np

from testbed.identification.fit import IDENTIFIED_BELOW, fix_unidentified


def _fitted(rows: np.ndarray, truth: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The maximum of the posterior of a linear model, its priors of spread 1, and its covariance."""
    posterior = np.linalg.inv(rows.T @ rows + np.eye(len(truth)))
    return posterior @ rows.T @ (rows @ truth + noise), posterior


def test_what_is_not_told_goes_back_to_the_file_with_the_priors_spread() -> None:
    kept = fix_unidentified(np.array([0.3, 0.2]), np.diag([1e-4, 0.95]), [0, 1])
    assert kept.fixed == (1,)
    np.testing.assert_allclose(kept.theta, [0.3, 0.0])
    np.testing.assert_allclose(kept.covariance, np.diag([1e-4, 1.0]))


def test_of_two_that_only_their_sum_tells_one_is_kept_and_the_other_makes_up_for_it() -> None:
    rows = 1e3 * np.array([[1.0, 1.0]])
    theta, posterior = _fitted(rows, np.array([0.5, 0.3]), np.zeros(1))
    kept = fix_unidentified(theta, posterior, [0, 1])
    assert len(kept.fixed) == 1
    np.testing.assert_allclose(kept.theta.sum(), 0.8, atol=1e-5)
    np.testing.assert_allclose(np.sqrt(np.diag(kept.covariance)), 1.0, rtol=1e-3)
    assert np.sqrt(kept.covariance.sum()) < 2e-3  # of their sum


def test_the_covariance_is_that_of_the_error_over_many_plants() -> None:
    """Plants drawn from the prior, six parameters by a design that leaves two of them untold."""
    rng = np.random.default_rng(7)
    rows = rng.standard_normal((40, 6)) * np.array([9.0, 5.0, 0.02, 3.0, 0.1, 7.0])
    rows[:, 3] += 2.0 * rows[:, 2] / 0.02  # the third shows as the fourth does
    errors, kept = [], None
    for _ in range(4000):
        truth = rng.standard_normal(6)
        theta, posterior = _fitted(rows, truth, rng.standard_normal(40))
        kept = fix_unidentified(theta, posterior, list(range(6)))
        errors.append(kept.theta - truth)
    assert kept is not None
    assert set(kept.fixed) == {2, 4}
    told = [k for k in range(6) if k not in kept.fixed]
    assert np.sqrt(np.diag(kept.covariance))[told].max() < IDENTIFIED_BELOW
    off = np.array(errors)
    nees = np.einsum("ni,ij,nj->n", off, np.linalg.inv(kept.covariance), off) / 6
    assert abs(np.mean(nees) - 1.0) < 0.05
    np.testing.assert_allclose(off.std(axis=0), np.sqrt(np.diag(kept.covariance)), rtol=0.06)
