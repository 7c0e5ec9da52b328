"""The figures of a report, as SVG that takes the colours of the page, and the style that all plots share."""

import io
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle
from numpy.typing import NDArray

from nominal_arm.dimensions import DhLink, skeleton
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
    ``q_cmd_rad`` and ``q_meas_rad`` (m, 6). ``links`` are the arm's by its drawing.
    """

    true_time_s: Array
    true_p_m: Array
    true_error_m: Array
    view_time_s: Array
    view_p_m: Array
    q_cmd_rad: Array
    q_meas_rad: Array
    links: tuple[DhLink, ...] = ()


def png(figure: Figure) -> bytes:
    """``figure`` as a picture."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def svg(figure: Figure, name: str) -> str:
    """``figure`` as an element of a page: as wide as its place, black in the page's own colour, text as text.

    ``name`` keeps its identifiers apart from those of other figures.
    """
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", text)
    return text.replace("#000000", "currentColor").replace("'DejaVu Sans'", "system-ui")


def _mark_stages(axes: Axes, stages: Sequence[Stage]) -> None:
    for stage in stages:
        axes.axvline(stage.time_s, color="0.6", linewidth=0.8, linestyle=":")


def _name_stages(axes: Axes, stages: Sequence[Stage]) -> None:
    """Write the stages' names above; of those too near to each other for that, together."""
    near_s = 0.04 * axes.get_xlim()[1]
    named: list[tuple[float, str]] = []
    for stage in stages:
        if named and stage.time_s - named[-1][0] < near_s:
            named[-1] = (named[-1][0], f"{named[-1][1]}, {stage.label}")
        else:
            named.append((stage.time_s, stage.label))
    top = axes.secondary_xaxis("top")
    top.set_xticks([at_s for at_s, _ in named], [name for _, name in named])
    top.tick_params(axis="x", labelrotation=20, labelsize=8)
    for label in top.get_xticklabels():
        label.set_horizontalalignment("left")


def arm_plot(traces: Traces) -> str:
    """The arm by its drawing at the measured joints, as it began and as it ended, and the way of its tool."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 4.4), layout="constrained")
        views = ((0, 2, "from the side"), (0, 1, "from above"))
        for axes, (i, j, title) in zip(figure.subplots(1, 2), views, strict=True):
            for row, colour, label in ((0, "0.65", "as it began"), (-1, "black", "as it ended")):
                if len(traces.q_meas_rad):
                    points = skeleton(traces.links, tuple(traces.q_meas_rad[row]))
                    axes.plot(points[:, i], points[:, j], "-o", color=colour, linewidth=3.0, label=label)
            way = traces.view_p_m
            axes.plot(way[:, i], way[:, j], color=AXIS_COLOURS[0], linewidth=1.0, label="the tool's way")
            axes.set(title=title, xlabel=f"{'xyz'[i]} / m, base", ylabel=f"{'xyz'[j]} / m, base")
            axes.set_aspect("equal", adjustable="datalim")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
        return svg(figure, "arm")


def path_plot(traces: Traces, stages: Sequence[Stage]) -> str:
    """The tool's way as it was (world) and as the controller's rigid model has it (base), from three sides;
    dots are where it rested."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 3.9), layout="constrained")
        panels = figure.subplots(1, 3)
        views = ((0, 2, "from the side"), (0, 1, "from above"), (1, 2, "from the front"))
        rests = np.searchsorted(traces.true_time_s, [stage.time_s for stage in stages])
        rests = np.clip(rests, 0, len(traces.true_time_s) - 1)
        for axes, (i, j, title) in zip(panels, views, strict=True):
            believed, true = traces.view_p_m, traces.true_p_m
            axes.plot(believed[:, i], believed[:, j], color="0.65", label="controller's rigid model")
            axes.plot(true[:, i], true[:, j], color=AXIS_COLOURS[0], label="true")
            axes.plot(true[rests, i], true[rests, j], "o", color="black", markersize=3.5, label="at rest")
            axes.set(title=title, xlabel=f"{'xyz'[i]} / m", ylabel=f"{'xyz'[j]} / m")
            axes.set_aspect("equal", adjustable="datalim")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
        return svg(figure, "path")


def error_plot(traces: Traces, stages: Sequence[Stage]) -> str:
    """The true error over time: all of it above, ±25 mm around zero below with the limit shaded."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 5.6), layout="constrained")
        whole, close = figure.subplots(2, 1, sharex=True)
        for axes in (whole, close):
            for axis, colour in enumerate(AXIS_COLOURS):
                error_mm = 1e3 * traces.true_error_m[:, axis]
                axes.plot(traces.true_time_s, error_mm, color=colour, label="xyz"[axis])
            _mark_stages(axes, stages)
            axes.set_ylabel("true error / mm")
        close.axhspan(-1e3 * LIMIT_M, 1e3 * LIMIT_M, color="0.5", alpha=0.2, linewidth=0, zorder=0)
        close.set(ylim=(-25.0, 25.0), xlabel="time / s", xlim=(0.0, traces.true_time_s[-1]))
        figure.legend(*whole.get_legend_handles_labels(), loc="outside upper right", ncols=3)
        _name_stages(whole, stages)
        return svg(figure, "error")


def target_plot(stages: Sequence[Stage]) -> str:
    """Where the tool stood beside the object in the camera's x-y plane after each look, true and measured,
    and the 95 % ellipse told before its drive: against what is wanted, and close."""
    looks = [stage for stage in stages if stage.look > 0]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 4.9), layout="constrained")
        wide, close = figure.subplots(1, 2)
        limit = 1e3 * LIMIT_M
        colours = colormaps["viridis"](np.linspace(0.35, 0.8, max(len(looks), 1)))
        for axes in (wide, close):
            square = Rectangle((-limit, -limit), 2 * limit, 2 * limit, color="0.5", alpha=0.2, linewidth=0)
            axes.add_patch(square)
            for stage, colour in zip(looks, colours, strict=False):
                _mark_end(axes, stage, colour)
            axes.set(xlabel="x / mm (right)", ylabel="y / mm (down)")
            axes.set_aspect("equal")
        places = np.array([1e3 * stage.true.p_m[:2] for stage in looks]).reshape(-1, 2)
        farthest = float(np.nanmax(np.abs(places), initial=0.0))
        told = max((1e3 * stage.told.ellipse[0] for stage in looks if stage.told is not None), default=0.0)
        reaches = (max(1.2 * limit, 1.15 * farthest, 1.1 * told), max(0.5, 1.6 * farthest))
        for axes, reach in zip((wide, close), reaches, strict=True):
            axes.set(xlim=(-reach, reach), ylim=(reach, -reach))
        wide.set_title(f"the shaded square is wanted: ±{limit:g} mm")
        close.set_title("close")
        if looks:
            figure.legend(*wide.get_legend_handles_labels(), loc="outside right upper")
        return svg(figure, "target")


def _mark_end(axes: Axes, stage: Stage, colour: Any) -> None:
    axes.plot(*(1e3 * stage.true.p_m[:2]), "o", color=colour, label=f"{stage.label}, true")
    if stage.image is not None:
        axes.plot(*(1e3 * stage.image.p_m[:2]), "x", color=colour, label=f"{stage.label}, measured")
    if stage.told is not None:
        major_m, minor_m, angle_rad = stage.told.ellipse
        told = Ellipse(
            tuple(1e3 * stage.told.mean_m[:2]),
            2e3 * major_m,
            2e3 * minor_m,
            angle=np.degrees(angle_rad),
            fill=False,
            edgecolor=colour,
        )
        axes.add_patch(told)
        axes.plot([], [], color=colour, label=f"{stage.label}, told before: 95 %")


def joint_plot(traces: Traces, stages: Sequence[Stage]) -> str:
    """Joint tracking: commanded and measured angles, and their difference."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 10.5), layout="constrained")
        panels = figure.subplots(6, 2, sharex=True)
        for joint, (angle, difference) in enumerate(panels):
            command, measured = traces.q_cmd_rad[:, joint], traces.q_meas_rad[:, joint]
            time_s = traces.view_time_s
            angle.plot(time_s, np.degrees(command), color="0.6", linewidth=2.4, label="commanded")
            angle.plot(time_s, np.degrees(measured), color=AXIS_COLOURS[1], linewidth=0.9, label="measured")
            angle.set_ylabel(f"{JOINTS[joint]} / °")
            difference.plot(time_s, 1e3 * (command - measured), color=AXIS_COLOURS[0], linewidth=0.9)
            difference.set_ylabel("difference / mrad")
            _mark_stages(angle, stages)
            _mark_stages(difference, stages)
        figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
        for axes in panels[-1]:
            axes.set(xlabel="time / s", xlim=(0.0, traces.true_time_s[-1]))
        return svg(figure, "joints")
