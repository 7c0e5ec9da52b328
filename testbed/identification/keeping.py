"""Which parameters a recording tells, and what becomes of the others: they keep the plant file's number.

Numbers that only a combination tells (a boom's mass and the tilt of the base) cannot all stay where they are:
one after the other, the least certain one is put back to the file's number and the rest are moved along, as
their covariance says, until all that is still fitted is told. What is then reported has its own covariance:
a kept number the prior's, and the fitted ones what those of the kept ones add to theirs.
"""

from typing import NamedTuple

import numpy as np

from testbed.identification.problem import FitProblem
from testbed.identification.recording import Array
from testbed.identification.shooting import Fit, Plan, refined

IDENTIFIED_BELOW = 0.5
"""σ over the prior's spread below which the recording, and not the prior, says what a parameter is."""


class FileKept(NamedTuple):
    """``kept`` parameters at the file's number, ``theta`` (p,) of all, ``covariance`` (p, p) of its error.

    In units of the priors' spreads.
    """

    kept: tuple[int, ...]
    theta: Array
    covariance: Array


def keep_untold(theta: Array, posterior: Array, machine: list[int]) -> FileKept:
    """Put those of ``machine`` that are not told back to 0, one by one, the others conditioned on it.

    ``theta`` (p,) and the covariance ``posterior`` (p, p) of the fit, in units of the priors' spreads.
    """
    found, left, kept = theta.copy(), posterior.copy(), list[int]()
    while True:
        spread = np.sqrt(np.maximum(np.diag(left), 0.0))
        open_ = [k for k in machine if k not in kept]
        worst = max(open_, key=lambda k: spread[k], default=-1)
        if worst < 0 or spread[worst] < IDENTIFIED_BELOW:
            break
        along = left[:, worst] / left[worst, worst]
        found -= along * found[worst]
        left -= np.outer(along, left[worst])
        kept.append(worst)
        found[kept] = 0.0
    if not kept:
        return FileKept((), found, left)
    slopes = np.linalg.solve(posterior[np.ix_(kept, kept)], posterior[kept]).T  # (p, kept) of the means
    left[kept] = 0.0
    left[:, kept] = 0.0
    return FileKept(tuple(kept), found, left + slopes @ slopes.T)


def _inverse(information: Array) -> Array:
    """The covariance of data of this ``information`` and the priors together, in units of the priors'."""
    return np.asarray(np.linalg.inv(information + np.eye(len(information))), dtype=np.float64)


def reported(problem: FitProblem, fit: Fit) -> Fit:
    """``fit`` with what the recording does not tell at the file's number, and the honest covariance.

    What is left beyond the noise told at rest widens what the data say, not what the priors do.
    """
    s, columns = problem.spreads, fit.jacobian * problem.spreads
    excess = max(fit.data / (fit.samples - len(s)), 1.0)
    posterior = _inverse(columns.T @ columns / excess)
    machine = [k for k, p in enumerate(problem.parameters) if not p.of_start]
    told = keep_untold(fit.theta / s, posterior, machine)
    covariance = told.covariance * np.outer(s, s)
    if not told.kept:
        return fit._replace(covariance=covariance)
    plan = Plan(0.0, 1, 0, (0.0, 0.1), 1e-6, frozenset(told.kept))
    moved = refined(problem, fit, told.theta * s, plan)
    return moved._replace(covariance=covariance, kept=told.kept, promised=fit.promised)
