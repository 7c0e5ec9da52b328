"""Figures of drawn runs: shares, quantiles, how errors compare with what was told, and what is demanded.

A run that refused or failed has NaN where it has no figure: it counts as failed in every share, and is left
out of quantiles and of what compares errors with predictions.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from testbed.campaigns.experiment import Check, at_least, at_most
from testbed.experiments.positioning.corrected_run import PositioningRow
from testbed.experiments.positioning.told import Told, told_checks
from testbed.experiments.positioning.worlds import Demands
from testbed.reporting.outcome import LIMIT_M
from vision_pc.core.se3 import Array

LIMIT_MM = 1e3 * LIMIT_M


def checks_of(rows: Sequence[PositioningRow], asked: Demands) -> list[Check]:
    """What a world asks of the rows of one arm. A run that failed counts as failed in every share."""
    one, shot, two = (worst_mm(rows, name) for name in ("look1", "one_shot", "look2"))
    floor = np.abs(vectors(rows, "look2", "servo_mm")).max(axis=1)
    return [
        at_least("one look: share within 5 mm", share(one, LIMIT_MM), asked.one_look),
        at_least("one shot: share within 5 mm", share(shot, LIMIT_MM), asked.open_loop),
        at_least("two looks: share within 5 mm", share(two, LIMIT_MM), asked.two_looks),
        at_most("two looks: median", quantile(two, 50), asked.median_mm, "mm"),
        at_most("two looks: 95 %", quantile(two, 95), asked.q95_mm, "mm"),
        at_most("the servo's floor alone after two: median", quantile(floor, 50), None, "mm"),
        at_most("the servo's floor alone after two: 95 %", quantile(floor, 95), None, "mm"),
        *_drives_apart(rows),
        at_most("one look: error over told σ, at most", worst_ratio(rows, "look1"), None),
        *told_checks("one look", told(rows, "look1", "before"), one, asked.honest),
        *told_checks("two looks", told(rows, "look2", "before"), two, False),
        *told_checks("one look, by odometry", told(rows, "look1", "after"), one, False),
        *told_checks("one shot", told(rows, "one_shot", "before"), shot, False),
    ]


def _drives_apart(rows: Sequence[PositioningRow]) -> list[Check]:
    """How differently drives end, one standard deviation of an axis; what all end off alike, a map learns."""
    ends = [vectors(rows, name, "servo_mm") for name in ("one_shot", "look1", "look2")]
    ends = [each[np.isfinite(each).all(axis=1)] for each in ends]
    variances = [each.var(axis=0, ddof=1) for each in ends if len(each) > 1]
    if not variances:
        return []
    return [
        at_most("how differently drives end, 1 σ an axis", float(np.sqrt(np.mean(variances))), None, "mm")
    ]


def told(rows: Sequence[PositioningRow], name: str, when: str) -> list[Told]:
    """What was told of a branch, ``before`` moving or ``after`` it by odometry."""
    return [getattr(getattr(row, name), when) for row in rows]


def worst_ratio(rows: Sequence[PositioningRow], name: str) -> float:
    """The largest |error| over the σ told beforehand, of x and of y; NaN where no run came to an end."""
    ratios = np.abs(vectors(rows, name, "true_mm") / vectors(rows, name, "std_mm"))
    ended = ratios[np.isfinite(ratios).all(axis=1)]
    return float(ended.max()) if len(ended) else float("nan")


def worst_mm(rows: Sequence[Any], name: str) -> Array:
    """The larger of |x| and |y| of a branch, one a run; NaN where the run failed."""
    return np.array([getattr(row, name).worst_mm for row in rows])


def share(values: Array, limit: float) -> float:
    """How many of all ``values`` are inside ``limit``; NaN, a run that stopped, is not."""
    return float(np.mean(np.nan_to_num(values, nan=np.inf) <= limit))


def quantile(values: Array, percent: float) -> float:
    """Of those that came to an end; NaN when none did."""
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, percent)) if len(finite) else float("nan")


def vectors(rows: Sequence[PositioningRow], branch: str, quantity: str) -> Array:
    """x and y (n, 2) of a branch's quantity."""
    return np.array([getattr(getattr(row, branch), quantity)[:2] for row in rows])
