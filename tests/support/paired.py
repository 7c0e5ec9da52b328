"""Differences of pairs that were measured in one run, so that a busy machine is busy for both."""

from collections.abc import Sequence

import numpy as np


def mean_and_half_width(differences: Sequence[float]) -> tuple[float, float]:
    """The mean of at least two differences and half the width of its 95 % interval (normal)."""
    half = 1.96 * np.std(differences, ddof=1) / np.sqrt(len(differences))
    return float(np.mean(differences)), float(half)
