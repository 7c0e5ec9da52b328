"""Statistics of drawn runs: shares, quantiles, errors against what was predicted, and what is demanded.

A run that refused or failed has NaN where it has no figure: it counts as failed in every share, and is left
out of quantiles and of what compares errors with predictions.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from rich.table import Table
from scipy import stats

from laboratory.campaigns.experiment import Check, at_least, at_most, inside
from laboratory.experiments.positioning.corrected_run import PositioningRow, Prediction
from laboratory.experiments.positioning.worlds import Demands
from testbed.reporting.console import table
from testbed.reporting.outcome import LIMIT_M
from testbed.reporting.plots import AXIS_COLOURS, STYLE
from vision_pc.core.se3 import Array

LIMIT_MM = 1e3 * LIMIT_M
CONFIDENT = 0.8  # predicted probability above which an end outside is an overconfident failure
NEES_BAND = (0.8, 1.25)
COVERED_BAND = (0.92, 0.98)
_DISTANCES_M = (0.3, 0.6, 0.9, 1.2)  # of the object from the tool at the start
_BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.999, 1.0)


def nees(predicted: Sequence[Prediction]) -> float:
    """Mean of half the squared distance, 1 when the predicted spread is right; NaN without any."""
    distances = _column(predicted, "distance2")
    return float(distances.mean() / 2.0) if len(distances) else float("nan")


def chance_band(runs: int) -> tuple[float, float]:
    """In which 95 % of such means over ``runs`` lie although the spread is right."""
    freedom = max(2 * runs, 1)
    low, high = (float(stats.chi2.ppf(side, freedom)) / freedom for side in (0.025, 0.975))
    return low, high


def covered(predicted: Sequence[Prediction]) -> float:
    """How many ends lie inside their 95 % ellipse; NaN without any."""
    distances, levels = _column(predicted, "distance2"), _column(predicted, "level2")
    return float(np.mean(distances <= levels)) if len(distances) else float("nan")


def overconfident_failures(predicted: Sequence[Prediction], worst_mm: Array) -> int:
    """Runs that ended outside although P ≥ 0.8, or nothing, was predicted; one that stopped is none."""
    outside = np.asarray(worst_mm) > 1e3 * LIMIT_M
    return int(np.count_nonzero(outside & ~(_probabilities(predicted) < CONFIDENT)))


def prediction_checks(
    what: str, predicted: Sequence[Prediction], worst_mm: Array, judged: bool
) -> list[Check]:
    """The verdict's lines about honesty; ``judged``: as limits (the bands widened by chance), else shown."""
    ended = len(_column(predicted, "distance2"))
    low, high = chance_band(ended)
    band = (min(NEES_BAND[0], low), max(NEES_BAND[1], high))
    few, many = (float(stats.binom.ppf(side, ended, 0.95)) / max(ended, 1) for side in (0.025, 0.975))
    share = (min(COVERED_BAND[0], few), max(COVERED_BAND[1], many))
    brier = _brier(predicted, worst_mm)
    return [
        inside(f"{what}: error² over predicted variance, mean", nees(predicted), band if judged else None),
        inside(
            f"{what}: share inside the predicted 95 % ellipse", covered(predicted), share if judged else None
        ),
        at_most(f"{what}: mean square error of the predicted probability", brier, None),
        at_most(
            f"{what}: overconfident failures",
            overconfident_failures(predicted, worst_mm),
            0 if judged else None,
        ),
    ]


def reliability_table(title: str, predicted: Sequence[Prediction], worst_mm: Array) -> Table:
    """By predicted probability: how many runs, its mean, how many ended inside."""
    cells = [
        [f"{low:g} to {high:g}", count, f"{mean:.3f}", f"{share:.3f}"]
        for low, high, count, mean, share in reliability(predicted, worst_mm)
    ]
    return table(title, ["predicted P", "runs", "mean", "ended inside"], cells)


def reliability(
    predicted: Sequence[Prediction], worst_mm: Array
) -> list[tuple[float, float, int, float, float]]:
    """(from, to, runs, mean predicted probability, share that ended inside) of each bin with runs in it."""
    probability = _probabilities(predicted)
    known = np.isfinite(probability) & np.isfinite(worst_mm)
    probability, good = probability[known], np.asarray(worst_mm)[known] <= 1e3 * LIMIT_M
    found = []
    for low, high in pairwise(_BINS):
        chosen = (probability >= low) & ((probability < high) | (high == _BINS[-1]))
        if chosen.any():
            means = float(probability[chosen].mean()), float(good[chosen].mean())
            found.append((low, high, int(chosen.sum()), *means))
    return found


def reliability_plot(groups: Mapping[str, tuple[Sequence[Prediction], Array]], title: str) -> Figure:
    """Share that ended inside over the probability predicted, a line a group, the diagonal is honest."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.6, 4.2), layout="constrained")
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [0.0, 1.0], color="0.6", linewidth=0.8)
        for (name, (predicted, worst)), colour in zip(groups.items(), AXIS_COLOURS, strict=False):
            bins = np.array([entry[2:] for entry in reliability(predicted, worst)]).reshape(-1, 3)
            axes.plot(bins[:, 1], bins[:, 2], "o-", color=colour, label=name)
            for count, x, y in bins:
                axes.annotate(f"{count:.0f}", (x, y), textcoords="offset points", xytext=(4, -9), fontsize=7)
        axes.set(
            xlabel="predicted probability", ylabel="share that ended inside", xlim=(0, 1.02), ylim=(0, 1.05)
        )
        axes.legend(loc="upper left")
        figure.suptitle(title)
        return figure


def _brier(predicted: Sequence[Prediction], worst_mm: Array) -> float:
    probability = _probabilities(predicted)
    known = np.isfinite(probability) & np.isfinite(worst_mm)
    good = (np.asarray(worst_mm) <= 1e3 * LIMIT_M)[known]
    return float(np.mean((probability[known] - good) ** 2)) if known.any() else float("nan")


def _probabilities(predicted: Sequence[Any]) -> Array:
    return np.array([one.probability for one in predicted], dtype=np.float64)


def _column(predicted: Sequence[Any], name: str) -> Array:
    values = np.array([getattr(one, name) for one in predicted], dtype=np.float64)
    return values[np.isfinite([one.distance2 for one in predicted])]


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
        at_most("one look: error over predicted σ, at most", worst_ratio(rows, "look1"), None),
        *prediction_checks("one look", predictions(rows, "look1", "before"), one, asked.honest),
        *prediction_checks("two looks", predictions(rows, "look2", "before"), two, False),
        *prediction_checks("one look, by odometry", predictions(rows, "look1", "after"), one, False),
        *prediction_checks("one shot", predictions(rows, "one_shot", "before"), shot, False),
        *_look_checks(rows, asked.honest),
    ]


def _look_checks(rows: Sequence[PositioningRow], judged: bool) -> list[Check]:
    """Whether looks at the start, at the end of the first drive and of the second know how wrong they are."""
    places = {
        "at the start": ("look1", "first"),
        "after one": ("look1", "last"),
        "after two": ("look2", "last"),
    }
    checks = []
    for where, (branch, when) in places.items():
        seen = predictions(rows, branch, when)
        checks += prediction_checks(f"a look {where}", seen, worst_mm(rows, branch), judged)[:2]
    for near, far in pairwise(_DISTANCES_M):
        apart = [row for row in rows if near <= row.distance_m < far]
        seen, what = predictions(apart, "look1", "first"), f"a look from {near:g} to {far:g} m"
        checks += prediction_checks(what, seen, worst_mm(apart, "look1"), False)[:2] if apart else []
    return checks


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


def predictions(rows: Sequence[PositioningRow], name: str, when: str) -> list[Prediction]:
    """What a branch says of its error: ``before``, ``after`` by odometry, ``first`` or ``last`` look."""
    return [getattr(getattr(row, name), when) for row in rows]


def worst_ratio(rows: Sequence[PositioningRow], name: str) -> float:
    """The largest |error| over the predicted σ, of x and of y; NaN where no run came to an end."""
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
