"""The figure of a report, and the style that all plots share."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from testbed.reporting.outcome import LIMIT_M, Stage

Array = NDArray[np.float64]

JOINTS = ("slew", "lift", "tilt", "wrist 1", "wrist 2", "wrist 3")
STYLE: dict[Any, Any] = {
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "font.size": 9,
    "grid.alpha": 0.3,
    "legend.frameon": False,
}
AXIS_COLOURS = ("#0072b2", "#d55e00", "#009e73")  # told apart by the colour-blind too
_CLOSE_MM = 25.0


class ErrorTrace(NamedTuple):
    """The tool's true error (n, 3) at the object, camera axes, at ``time_s`` (n,) from the run's start."""

    time_s: Array
    error_m: Array


def error_figure(trace: ErrorTrace, stages: Sequence[Stage]) -> Figure:
    """The true error over time within ±25 mm, and in the camera's x-y plane after each look."""
    limit = 1e3 * LIMIT_M
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 4.4), layout="constrained")
        over_time, plane = figure.subplots(1, 2, width_ratios=(2, 1))
        for axis, colour in enumerate(AXIS_COLOURS):
            over_time.plot(trace.time_s, 1e3 * trace.error_m[:, axis], color=colour, label="xyz"[axis])
        over_time.set(xlabel="time / s", ylabel="true error / mm", ylim=(-_CLOSE_MM, _CLOSE_MM))
        over_time.axhspan(-limit, limit, color="0.5", alpha=0.2, linewidth=0)
        over_time.legend(ncols=3)
        plane.axhspan(-limit, limit, 0.5 - 0.5 / 1.2, 0.5 + 0.5 / 1.2, color="0.5", alpha=0.2, linewidth=0)
        for stage in stages:
            over_time.axvline(stage.time_s, color="0.6", linewidth=0.8, linestyle=":")
            if stage.look:
                _mark_end(plane, stage)
        reach = 1.2 * limit
        plane.set(xlabel="x / mm (right)", ylabel="y / mm (down)", xlim=(-reach, reach), ylim=(reach, -reach))
        plane.set_aspect("equal")
        plane.legend()
    return figure


def _mark_end(axes: Axes, stage: Stage) -> None:
    (dot,) = axes.plot(*(1e3 * stage.true.p_m[:2]), "o", label=f"{stage.label}, true")
    if stage.image is not None:
        axes.plot(*(1e3 * stage.image.p_m[:2]), "x", color=dot.get_color(), label="measured")
    if stage.predicted is not None:
        mean, ellipse = stage.predicted["mean_mm"], stage.predicted["ellipse_95_mm"]
        size = 2 * ellipse["major"], 2 * ellipse["minor"]
        outline = Ellipse((mean["x"], mean["y"]), *size, angle=ellipse["angle_deg"], fill=False)
        outline.set(edgecolor=dot.get_color(), label="predicted: 95 %")
        axes.add_patch(outline)
