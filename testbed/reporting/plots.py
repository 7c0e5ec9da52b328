"""The figures of a report, as PNG bytes."""

import io
from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
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


class TracedView(NamedTuple):
    """The controller's own view at ``time_ns`` of vision's clock, for the report's curves."""

    time_ns: int
    p_m: Sequence[float]
    q_cmd_rad: Sequence[float]
    q_meas_rad: Sequence[float]


class Traces(NamedTuple):
    """Time series of one run, n samples, times in seconds from its start.

    From the plant: ``true_time_s`` (n,), ``true_p_m`` (n, 3) the tool in the world, ``true_error_m`` (n, 3).
    From the controller: ``view_time_s`` (m,), ``view_p_m`` (m, 3) the tool in the base by the rigid model,
    ``q_cmd_rad`` and ``q_meas_rad`` (m, 6).
    """

    true_time_s: Array
    true_p_m: Array
    true_error_m: Array
    view_time_s: Array
    view_p_m: Array
    q_cmd_rad: Array
    q_meas_rad: Array


def png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def _mark_stages(axes: Axes, stages: Sequence[Stage]) -> None:
    for stage in stages:
        axes.axvline(stage.time_s, color="0.6", linewidth=0.8, linestyle=":")


def path_plot(traces: Traces, stages: Sequence[Stage]) -> bytes:
    """The tool's way as it was (world) and as the controller's rigid model has it (base), from three sides;
    dots are where it rested."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 3.8), layout="constrained")
        panels = figure.subplots(1, 3)
        views = ((0, 2, "side: x, z"), (0, 1, "above: x, y"), (1, 2, "front: y, z"))
        rests = np.searchsorted(traces.true_time_s, [stage.time_s for stage in stages])
        rests = np.clip(rests, 0, len(traces.true_time_s) - 1)
        for axes, (i, j, title) in zip(panels, views, strict=True):
            axes.plot(
                traces.view_p_m[:, i], traces.view_p_m[:, j], color="0.65", label="controller's rigid model"
            )
            axes.plot(traces.true_p_m[:, i], traces.true_p_m[:, j], color=AXIS_COLOURS[0], label="true")
            axes.plot(
                traces.true_p_m[rests, i], traces.true_p_m[rests, j], "o", color="black", markersize=3.5
            )
            axes.set(title=title, xlabel=f"{'xyz'[i]} / m", ylabel=f"{'xyz'[j]} / m")
            axes.set_aspect("equal", adjustable="datalim")
        panels[0].legend(loc="best")
        return png(figure)


def error_plot(traces: Traces, stages: Sequence[Stage]) -> bytes:
    """The true error over time: all of it above, ±25 mm around zero below with the limit shaded."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 5.6), layout="constrained")
        whole, close = figure.subplots(2, 1, sharex=True)
        for axes in (whole, close):
            for axis, colour in enumerate(AXIS_COLOURS):
                axes.plot(
                    traces.true_time_s, 1e3 * traces.true_error_m[:, axis], color=colour, label="xyz"[axis]
                )
            _mark_stages(axes, stages)
            axes.set_ylabel("true error / mm")
        close.axhspan(-1e3 * LIMIT_M, 1e3 * LIMIT_M, color="0.9", zorder=0)
        close.set(ylim=(-25.0, 25.0), xlabel="time / s")
        whole.legend(loc="upper right", ncols=3)
        top = whole.secondary_xaxis("top")
        top.set_xticks([stage.time_s for stage in stages], [stage.label for stage in stages])
        top.tick_params(axis="x", labelrotation=20, labelsize=8)
        for label in top.get_xticklabels():
            label.set_horizontalalignment("left")
        return png(figure)


def target_plot(stages: Sequence[Stage]) -> bytes:
    """Where the tool stood beside the object in the camera's x-y plane after each look, true and measured."""
    looks = [stage for stage in stages if stage.look > 0]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(5.0, 4.6), layout="constrained")
        axes = figure.subplots()
        limit = 1e3 * LIMIT_M
        axes.add_patch(Rectangle((-limit, -limit), 2 * limit, 2 * limit, color="0.9", zorder=0))
        reach = 2.0 * limit
        for stage, colour in zip(
            looks, colormaps["viridis"](np.linspace(0.15, 0.75, max(len(looks), 1))), strict=False
        ):
            x, y = 1e3 * stage.true.p_m[:2]
            reach = max(reach, 1.15 * abs(x), 1.15 * abs(y))
            axes.plot(x, y, "o", color=colour, label=f"{stage.label}, true")
            if stage.image is not None:
                axes.plot(*(1e3 * stage.image.p_m[:2]), "x", color=colour, label=f"{stage.label}, image")
        axes.set(xlim=(-reach, reach), ylim=(reach, -reach), xlabel="x / mm (right)", ylabel="y / mm (down)")
        axes.set_aspect("equal")
        if looks:
            axes.legend(loc="upper left", fontsize=8)
        return png(figure)


def joint_plot(traces: Traces, stages: Sequence[Stage]) -> bytes:
    """Joint tracking: commanded and measured angles, and their difference."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 10.5), layout="constrained")
        panels = figure.subplots(6, 2, sharex=True)
        for joint, (angle, difference) in enumerate(panels):
            command, measured = traces.q_cmd_rad[:, joint], traces.q_meas_rad[:, joint]
            angle.plot(
                traces.view_time_s, np.degrees(command), color="black", linewidth=0.9, label="commanded"
            )
            angle.plot(
                traces.view_time_s,
                np.degrees(measured),
                color=AXIS_COLOURS[1],
                linewidth=0.9,
                label="measured",
            )
            angle.set_ylabel(f"{JOINTS[joint]} / °")
            difference.plot(
                traces.view_time_s, 1e3 * (command - measured), color=AXIS_COLOURS[0], linewidth=0.9
            )
            difference.set_ylabel("difference / mrad")
            _mark_stages(angle, stages)
            _mark_stages(difference, stages)
        panels[0][0].legend(loc="best", ncols=2)
        for axes in panels[-1]:
            axes.set_xlabel("time / s")
        return png(figure)
