"""What runs were told before they were looked at, against what became true: spread, ellipse, probability."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from rich.table import Table
from scipy import stats

from testbed.campaigns.experiment import Check, at_most, inside
from testbed.reporting.console import table
from testbed.reporting.outcome import LIMIT_M
from testbed.reporting.plots import AXIS_COLOURS, STYLE
from vision_pc.core.positioning.expected_end import ExpectedEnd, ellipse_level
from vision_pc.core.se3 import Array

CONFIDENT = 0.8  # a run that was told more and ends outside was a silent miss
NEES_BAND = (0.8, 1.25)
COVERED_BAND = (0.92, 0.98)
_BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.999, 1.0)


class Told(NamedTuple):
    """What was told of the end's error in x and y, and where the true error lies in it.

    ``probability`` to end inside the tolerance; mean, standard deviations, correlation and Student's
    ``freedom`` (NaN: normal). ``distance2``: squared distance of the true error from the mean, by the whole
    covariance, 2 in the mean when honest; ``level2``: what 95 % stay below.
    """

    probability: float = float("nan")
    mean_x_mm: float = float("nan")
    mean_y_mm: float = float("nan")
    std_x_mm: float = float("nan")
    std_y_mm: float = float("nan")
    correlation: float = float("nan")
    freedom: float = float("nan")
    distance2: float = float("nan")
    level2: float = float("nan")


def told_of(end: ExpectedEnd, true_mm: Array) -> Told:
    """The columns of ``end``, when the error became ``true_mm`` (3,)."""
    x, y = 1e3 * end.mean_m[:2]
    std_x, std_y = 1e3 * end.std_m[:2]
    off = 1e-3 * true_mm[:2] - end.mean_m[:2]
    distance2 = float(off @ np.linalg.solve(end.covariance[:2, :2], off))
    freedom = end.freedom if np.isfinite(end.freedom) else float("nan")
    level = ellipse_level(end.freedom)
    return Told(
        end.inside, float(x), float(y), float(std_x), float(std_y), end.correlation, freedom, distance2, level
    )


def nees(told: Sequence[Told]) -> float:
    """Mean of half the squared distance, 1 when the spread told is the spread; NaN without any."""
    distances = _column(told, "distance2")
    return float(distances.mean() / 2.0) if len(distances) else float("nan")


def chance_band(runs: int) -> tuple[float, float]:
    """In which 95 % of such means over ``runs`` lie although the spread is right."""
    freedom = max(2 * runs, 1)
    low, high = (float(stats.chi2.ppf(side, freedom)) / freedom for side in (0.025, 0.975))
    return low, high


def covered(told: Sequence[Told]) -> float:
    """How many ends lie inside their 95 % ellipse; NaN without any."""
    distances, levels = _column(told, "distance2"), _column(told, "level2")
    return float(np.mean(distances <= levels)) if len(distances) else float("nan")


def silent_misses(told: Sequence[Told], worst_mm: Array) -> int:
    """Runs that ended outside unwarned: told P ≥ 0.8, or nothing; a run that stopped was not silent."""
    outside = np.asarray(worst_mm) > 1e3 * LIMIT_M
    return int(np.count_nonzero(outside & ~(_probabilities(told) < CONFIDENT)))


def told_checks(what: str, told: Sequence[Told], worst_mm: Array, judged: bool) -> list[Check]:
    """The verdict's lines about honesty; ``judged``: as limits (the bands widened by chance), else told."""
    ended = len(_column(told, "distance2"))
    low, high = chance_band(ended)
    band = (min(NEES_BAND[0], low), max(NEES_BAND[1], high))
    few, many = (float(stats.binom.ppf(side, ended, 0.95)) / max(ended, 1) for side in (0.025, 0.975))
    share = (min(COVERED_BAND[0], few), max(COVERED_BAND[1], many))
    brier = _brier(told, worst_mm)
    return [
        inside(f"{what}: error² over predicted variance, mean", nees(told), band if judged else None),
        inside(f"{what}: share inside the predicted 95 % ellipse", covered(told), share if judged else None),
        at_most(f"{what}: mean square error of the told probability", brier, None),
        at_most(f"{what}: silent misses", silent_misses(told, worst_mm), 0 if judged else None),
    ]


def reliability_table(title: str, told: Sequence[Told], worst_mm: Array) -> Table:
    """By told probability: how many runs, what they were told in the mean, how many ended inside."""
    cells = [
        [f"{low:g} to {high:g}", count, f"{mean:.3f}", f"{share:.3f}"]
        for low, high, count, mean, share in reliability(told, worst_mm)
    ]
    return table(title, ["told P", "runs", "mean told", "ended inside"], cells)


def reliability(told: Sequence[Told], worst_mm: Array) -> list[tuple[float, float, int, float, float]]:
    """(from, to, runs, mean told probability, share that ended inside) of each bin with runs in it."""
    probability = _probabilities(told)
    known = np.isfinite(probability) & np.isfinite(worst_mm)
    probability, good = probability[known], np.asarray(worst_mm)[known] <= 1e3 * LIMIT_M
    found = []
    for low, high in pairwise(_BINS):
        chosen = (probability >= low) & ((probability < high) | (high == _BINS[-1]))
        if chosen.any():
            means = float(probability[chosen].mean()), float(good[chosen].mean())
            found.append((low, high, int(chosen.sum()), *means))
    return found


def reliability_plot(groups: Mapping[str, tuple[Sequence[Told], Array]], title: str) -> Figure:
    """Share that ended inside over the probability told, a line a group, the diagonal is honest."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.6, 4.2), layout="constrained")
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [0.0, 1.0], color="0.6", linewidth=0.8)
        for (name, (told, worst)), colour in zip(groups.items(), AXIS_COLOURS, strict=False):
            bins = np.array([entry[2:] for entry in reliability(told, worst)]).reshape(-1, 3)
            axes.plot(bins[:, 1], bins[:, 2], "o-", color=colour, label=name)
            for count, x, y in bins:
                axes.annotate(f"{count:.0f}", (x, y), textcoords="offset points", xytext=(4, -9), fontsize=7)
        axes.set(xlabel="probability told", ylabel="share that ended inside", xlim=(0, 1.02), ylim=(0, 1.05))
        axes.legend(loc="upper left")
        figure.suptitle(title)
        return figure


def _brier(told: Sequence[Told], worst_mm: Array) -> float:
    probability = _probabilities(told)
    known = np.isfinite(probability) & np.isfinite(worst_mm)
    good = (np.asarray(worst_mm) <= 1e3 * LIMIT_M)[known]
    return float(np.mean((probability[known] - good) ** 2)) if known.any() else float("nan")


def _probabilities(told: Sequence[Any]) -> Array:
    return np.array([one.probability for one in told], dtype=np.float64)


def _column(told: Sequence[Any], name: str) -> Array:
    values = np.array([getattr(one, name) for one in told], dtype=np.float64)
    return values[np.isfinite([one.distance2 for one in told])]
