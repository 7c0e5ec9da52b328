"""A number with its standard deviation, and how repeated measurements become one."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Uncertain(NamedTuple):
    """``value`` with its standard deviation ``std``, in the same unit."""

    value: float
    std: float


def repeated(values: Sequence[float], floor: float) -> Uncertain:
    """The mean of ``values`` as one number.

    ``floor``: standard deviation of what all of them share (the model's own error), which repeating does not
    reduce. The scatter of n values counts with Student's spread, (n − 1)/(n − 3) above three values, and 3
    times below: so few say little about their own scatter.
    """
    data = np.asarray(values, dtype=np.float64)
    n = len(data)
    if n < 2:
        raise ValueError(f"{n} values: at least two are wanted")
    scatter = float(data.std(ddof=1)) / math.sqrt(n)
    widened = scatter * math.sqrt((n - 1) / (n - 3) if n > 3 else 3.0)
    return Uncertain(float(data.mean()), math.hypot(widened, floor))


def midway(a: Uncertain, b: Uncertain) -> Uncertain:
    """The mean of two independent estimates."""
    return Uncertain(0.5 * (a.value + b.value), 0.5 * math.hypot(a.std, b.std))
