"""What a fit found, parameter by parameter, in the units of the plant file: value, σ, identified or kept."""

import math
from typing import NamedTuple

import numpy as np

from testbed.identification.fit import Identified
from testbed.identification.parameters import Parameter, value
from testbed.identification.recording import Array

IDENTIFIED_BELOW = 0.5
"""σ over the prior's spread below which the recording, and not the prior, says what a parameter is."""


class FittedNumber(NamedTuple):
    """One parameter: the file's number, the fitted one and its σ in ``unit``; σ over the prior's spread."""

    name: str
    unit: str
    file: float
    fitted: float
    std: float
    of_prior: float
    source: str

    @property
    def identified(self) -> bool:
        """Whether the recording tells it."""
        return self.of_prior < IDENTIFIED_BELOW

    @property
    def percent(self) -> float:
        """σ in per cent of the fitted number."""
        return 100.0 * self.std / abs(self.fitted) if self.fitted else math.inf


def excess(found: Identified) -> float:
    """χ² of what is left over the number of samples: 1 where noise alone is left."""
    return found.whole.data / (found.whole.samples - len(found.whole.theta))


def covariance(found: Identified) -> Array:
    """The covariance (p, p) of the fit; what is left beyond the noise told at rest widens it."""
    return found.whole.covariance * max(excess(found), 1.0)


def findings(found: Identified) -> list[FittedNumber]:
    """Every parameter of the machine, in the fit's order."""
    stds = np.sqrt(np.diag(covariance(found)))
    return [
        _finding(parameter, found, float(theta), float(std))
        for parameter, theta, std in zip(found.problem.parameters, found.whole.theta, stds, strict=True)
        if not parameter.of_start
    ]


def _finding(parameter: Parameter, found: Identified, theta: float, std: float) -> FittedNumber:
    base = found.problem.base
    fitted = value(base, parameter, theta)
    return FittedNumber(
        parameter.name,
        parameter.unit,
        value(base, parameter, 0.0),
        fitted,
        std * abs(fitted) if parameter.kind == "factor" else std,
        min(std / parameter.spread, 1.0),
        parameter.source,
    )
