"""The experiments' rows as pictures, beside the paper's figures where it printed any."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from testbed.experiments.hand_eye.localisation import LocalisationRow
from testbed.experiments.hand_eye.noise_sweep import SweepRow

_HIGHLIGHTED = {
    "tsai": "#999999",
    "horaud": "#e69f00",
    "daniilidis": "#56b4e9",
    "dqcr": "#0072b2",
    "robust": "#d55e00",
}


def sweep_plot(rows: Sequence[SweepRow]) -> Figure:
    """Fig. 7 as a picture: rotation and translation error of each method over d, with the bound."""
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    for axes, unit, value, bound in (
        (figure.add_subplot(1, 2, 1), "rotation / deg", "rotation_deg", "bound_rotation_deg"),
        (figure.add_subplot(1, 2, 2), "translation / mm", "translation_mm", "bound_translation_mm"),
    ):
        for method in dict.fromkeys(r.method for r in rows):
            mine = [r for r in rows if r.method == method]
            colour = _HIGHLIGHTED.get(method)
            style: dict[str, Any] = {"color": colour or "0.75", "lw": 2.0 if colour else 0.8}
            label = method if colour else None
            axes.plot([r.level for r in mine], [getattr(r, value) for r in mine], label=label, **style)
        first = [r for r in rows if r.method == rows[0].method]
        levels = [r.level for r in first]
        axes.plot(levels, [getattr(r, bound) for r in first], "k--", lw=1.0, label="Cramér-Rao bound")
        axes.set(xlabel="noise level d", ylabel=f"rms error of X, {unit}", yscale="log")
        axes.grid(alpha=0.3, which="both")
    figure.axes[0].legend(frameon=False, fontsize=8)
    figure.suptitle(f"Hua et al. 2024, Fig. 7: noise on {rows[0].noise_on}; grey: the other methods")
    return figure


def localisation_plot(rows: Sequence[LocalisationRow]) -> Figure:
    """Fig. 5 and 6 as a picture: error with its interval, share within 3 mm; the paper's figures as dots."""
    mine = [r for r in rows if r.task == "all" and r.error_mm < 12.0]
    names = [f"{r.method}\n{r.samples}" for r in mine]
    x = np.arange(len(mine))
    colours = [_HIGHLIGHTED.get(r.method, "0.75") for r in mine]
    figure = Figure(figsize=(12.0, 5.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    errors = np.array([[r.error_mm - r.lowest_mm, r.highest_mm - r.error_mm] for r in mine]).T
    left.bar(x, [r.error_mm for r in mine], yerr=np.maximum(errors, 0.0), color=colours, capsize=2)
    left.plot(x, [math.nan if r.paper_mm is None else r.paper_mm for r in mine], "ko", label="paper, Fig. 5")
    left.set_ylabel("localisation error / mm")
    right.bar(x, [r.recognised_percent for r in mine], color=colours)
    recognised = [
        math.nan if r.paper_recognised_percent is None else r.paper_recognised_percent for r in mine
    ]
    right.plot(x, recognised, "ko", label="paper, Fig. 6")
    right.set_ylabel("within 3 mm / %")
    for axes in (left, right):
        axes.set_xticks(x, names, rotation=90, fontsize=7)
        axes.legend(frameon=False)
        axes.grid(alpha=0.3, axis="y")
    return figure


def intrinsics_plot(maps: Sequence[dict[str, Any]]) -> Figure:
    """Fig. 4 as a picture: for each detector where corners fell, and the error of each view."""
    figure = Figure(figsize=(3.4 * len(maps), 5.6), layout="constrained")
    axes = figure.subplots(2, len(maps), squeeze=False)
    most = max(np.max(kept["coverage"]) for kept in maps)
    for kept, above, below in zip(maps, axes[0], axes[1], strict=True):
        image = above.imshow(kept["coverage"], vmin=0, vmax=most, cmap="viridis", extent=(0, 640, 480, 0))
        above.set_title(f"{kept['detector']}: corners a cell", fontsize=9)
        for (i, j), count in np.ndenumerate(np.array(kept["coverage"])):
            above.text(80 * j + 40, 80 * i + 40, count, ha="center", va="center", color="w", fontsize=7)
        below.bar(kept["names"], kept["view_rms_px"], color="#0072b2")
        below.axhline(3.0 * float(np.median(kept["view_rms_px"])), color="0.4", ls="--", lw=1.0)
        below.set(xlabel="view (dashed: named as outlying above)", ylabel="rms error / px")
        below.tick_params(axis="x", rotation=90, labelsize=7)
    figure.colorbar(image, ax=axes[0], shrink=0.8)
    return figure
