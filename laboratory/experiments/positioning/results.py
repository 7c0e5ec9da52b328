"""Statistics of drawn runs: shares, quantiles, errors against what was predicted, and what is demanded.

A run that refused or failed has NaN where it has no figure: it counts as failed in every share, and is left
out of quantiles and of what compares errors with predictions.
"""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from laboratory.campaigns.experiment import Check, at_least, at_most, inside
from laboratory.campaigns.rows import Row, column
from laboratory.experiments.positioning.worlds import Demands
from testbed.reporting.outcome import LIMIT_M
from vision_pc.core.se3 import Array

LIMIT_MM = 1e3 * LIMIT_M
CONFIDENT = 0.8  # predicted probability above which an end outside is an overconfident failure
NEES_BAND = (0.8, 1.25)
COVERED_BAND = (0.92, 0.98)


def nees(rows: Sequence[Row], of: str) -> float:
    """Mean of half the squared distance, 1 when the predicted spread is right; NaN without any.

    ``of``: a prediction, such as ``look1_before``.
    """
    distances = _distances(rows, of)
    return float(np.nanmean(distances) / 2.0) if np.isfinite(distances).any() else float("nan")


def chance_band(freedom: int) -> tuple[float, float]:
    """Where 95 of 100 means of so many squared standard errors lie although their spread is right."""
    low, high = (float(stats.chi2.ppf(side, freedom)) / freedom for side in (0.025, 0.975))
    return low, high


def covered(rows: Sequence[Row], of: str) -> float:
    """How many ends lie inside their 95 % ellipse; NaN without any."""
    distances, levels = _distances(rows, of), column(rows, f"{of}_level2")
    ended = np.isfinite(distances)
    return float(np.mean(distances[ended] <= levels[ended])) if ended.any() else float("nan")


def overconfident_failures(rows: Sequence[Row], of: str) -> int:
    """Runs that ended outside although P ≥ 0.8, or nothing, was predicted; one that stopped is none."""
    outside = worst_mm(rows, of.rpartition("_")[0]) > LIMIT_MM
    return int(np.count_nonzero(outside & ~(column(rows, f"{of}_probability") < CONFIDENT)))


def prediction_checks(what: str, rows: Sequence[Row], of: str) -> list[Check]:
    """The verdict's lines about honesty, their bands widened by chance."""
    ended = int(np.isfinite(_distances(rows, of)).sum())
    low, high = chance_band(max(2 * ended, 1))
    band = (min(NEES_BAND[0], low), max(NEES_BAND[1], high))
    few, many = (float(stats.binom.ppf(side, ended, 0.95)) / max(ended, 1) for side in (0.025, 0.975))
    share = (min(COVERED_BAND[0], few), max(COVERED_BAND[1], many))
    return [
        inside(f"{what}: error² over predicted variance, mean", nees(rows, of), band),
        inside(f"{what}: share inside the predicted 95 % ellipse", covered(rows, of), share),
        at_most(f"{what}: overconfident failures", overconfident_failures(rows, of), 0),
    ]


def _distances(rows: Sequence[Row], of: str) -> Array:
    return column(rows, f"{of}_distance2")


def checks_of(rows: Sequence[Row], demands: Demands) -> list[Check]:
    """What a world asks of the rows of one arm. A run that failed counts as failed in every share."""
    one, shot, two = (worst_mm(rows, name) for name in ("look1", "one_shot", "look2"))
    looks = {"at the start": "look1_first", "after one": "look1_last", "after two": "look2_last"}
    return [
        at_least("one look: share within 5 mm", share(one, LIMIT_MM), demands.one_look),
        at_least("one shot: share within 5 mm", share(shot, LIMIT_MM), demands.open_loop),
        at_least("two looks: share within 5 mm", share(two, LIMIT_MM), demands.two_looks),
        at_most("two looks: median", quantile(two, 50), demands.median_mm, "mm"),
        at_most("two looks: 95 %", quantile(two, 95), demands.q95_mm, "mm"),
        *prediction_checks("one look", rows, "look1_before"),
        *(
            check
            for where, of in looks.items()
            for check in prediction_checks(f"a look {where}", rows, of)[:2]
        ),
    ]


def worst_mm(rows: Sequence[Row], branch: str) -> Array:
    """The larger of |x| and |y| of a branch, one a run; NaN where the run failed."""
    return column(rows, f"{branch}_worst_mm")


def share(values: Array, limit: float) -> float:
    """How many of all ``values`` are inside ``limit``; NaN, a run that stopped, is not."""
    return float(np.mean(np.nan_to_num(values, nan=np.inf) <= limit))


def quantile(values: Array, percent: float) -> float:
    """Of those that came to an end; NaN when none did."""
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, percent)) if len(finite) else float("nan")
