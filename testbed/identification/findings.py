"""What a fit found, parameter by parameter, in the units of the plant file: value, σ, identified or kept."""

import math
from typing import NamedTuple

import numpy as np

from testbed.identification.fit import Identified
from testbed.identification.keeping import IDENTIFIED_BELOW
from testbed.identification.parameters import Parameter, value


class FittedNumber(NamedTuple):
    """One parameter: the file's number, the reported one and its σ in ``unit``; σ over the prior's spread.

    ``kept``: it is the file's number and the prior's σ.
    """

    name: str
    unit: str
    file: float
    fitted: float
    std: float
    of_prior: float
    source: str
    kept: bool

    @property
    def identified(self) -> bool:
        """Whether the recording tells it."""
        return not self.kept and self.of_prior < IDENTIFIED_BELOW

    @property
    def told(self) -> str:
        """How the number was come by."""
        if self.kept:
            return "kept at the prior"
        return "identified" if self.identified else "only with those kept"

    @property
    def percent(self) -> float:
        """σ in per cent of the fitted number."""
        return 100.0 * self.std / abs(self.fitted) if self.fitted else math.inf


def excess(found: Identified) -> float:
    """χ² of what is left over the number of samples: 1 where noise alone is left."""
    return found.whole.data / (found.whole.samples - len(found.whole.theta))


def findings(found: Identified) -> list[FittedNumber]:
    """Every parameter of the machine, in the fit's order."""
    stds = np.sqrt(np.diag(found.whole.covariance))
    return [
        _finding(parameter, found, index, float(stds[index]))
        for index, parameter in enumerate(found.problem.parameters)
        if not parameter.of_start
    ]


def _finding(parameter: Parameter, found: Identified, index: int, std: float) -> FittedNumber:
    base = found.problem.base
    fitted = value(base, parameter, float(found.whole.theta[index]))
    return FittedNumber(
        parameter.name,
        parameter.unit,
        value(base, parameter, 0.0),
        fitted,
        std * abs(fitted) if parameter.kind == "factor" else std,
        std / parameter.spread,
        parameter.source,
        index in found.whole.kept,
    )
