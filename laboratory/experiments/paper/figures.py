"""The paper's figures 5 to 9 from one traced measurement of ours."""

from collections.abc import Mapping

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from laboratory.experiments.paper.comparison import SUB_CENTIMETRE_MM
from testbed.reporting.plots import AXIS_COLOURS, STYLE
from vision_pc.core.se3 import Array

Trace = Mapping[str, Array]

KINDS = {"fig5": "line", "fig6": "line", "fig7": "line", "fig8": "match", "fig9": "match"}
"""The kind of measurement that each figure is of."""


def draw(name: str, traced: Trace) -> Figure:
    """Figure ``name``."""
    drawings = {"fig5": _fig5, "fig6": _fig6, "fig7": _fig7, "fig8": _fig8, "fig9": _fig9}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(5.5, 4.2), layout="constrained")
        drawings[name](figure.subplots(), traced)
    return figure


def _fig5(over_time: Axes, traced: Trace) -> None:
    until = float(traced["input_s"][1])
    _curves(over_time, traced, "turn_deg", until, 1.0, traced["input_s"][:1])
    at_rest = traced["look_s"] < until
    for axis, colour in enumerate(AXIS_COLOURS):
        turn = traced["look_turn_deg"][at_rest, axis]
        over_time.plot(traced["look_s"][at_rest], turn, "o", color=colour, markersize=7, fillstyle="none")
    failed = np.isnan(traced["turn_deg"][:, 0]) & (traced["time_s"] < until)  # the paper draws zeros there
    over_time.plot(traced["time_s"][failed], np.zeros(int(failed.sum())), "|", color="black")
    over_time.set(
        ylabel="Euler angle / °",
        title="one measurement; rings: looks at rest; ticks: nothing seen",
    )


def _fig6(front: Axes, traced: Trace) -> None:
    begun, last = traced["input_s"][2:4]
    after = traced["p_BT"][(traced["time_s"] > begun) & (traced["time_s"] < last)]
    driven = np.vstack([traced["path_p_BT"], after])
    _front(
        front,
        ("wanted", traced["corners_1"], "black"),
        ("driven, by the encoders", driven, AXIS_COLOURS[1]),
        ("", traced["corners_2"], "black"),
    )
    front.plot(-traced["corners_2"][-1, 1], traced["corners_2"][-1, 2], "o", color="black", label="reference")
    front.legend(loc="best")


def _fig7(over_time: Axes, traced: Trace) -> None:
    _curves(over_time, traced, "error_m", float(traced["input_s"][3]), 1e3, traced["input_s"][1:3])
    over_time.set(ylabel="error in the picture / mm", title="circle, then one input")


def _fig8(front: Axes, traced: Trace) -> None:
    tool = traced["path_p_BT"]
    camera = traced["path_p_C0C"] @ traced["R_BC"].T
    camera = camera - camera.mean(axis=0) + tool.mean(axis=0)
    _front(
        front,
        ("wanted", traced["corners_1"], AXIS_COLOURS[2]),
        ("tool, by the encoders", tool, "black"),
        ("camera, after the match", camera, AXIS_COLOURS[1]),
    )


def _fig9(over_time: Axes, traced: Trace) -> None:
    given = traced["input_s"][2:4]
    after = traced["time_s"] > given[0] - 1.0
    shown = {name: value[after] for name, value in traced.items() if name in ("time_s", "error_m")}
    _curves(over_time, shown, "error_m", float(traced["time_s"][-1]), 1e3, given)
    over_time.axhspan(-SUB_CENTIMETRE_MM, SUB_CENTIMETRE_MM, color="0.5", alpha=0.2, linewidth=0, zorder=0)
    over_time.set(ylabel="error in the picture / mm", title="two inputs after the match")


def _front(axes: Axes, *paths: tuple[str, Array, str]) -> None:
    """The arm's front view, the tool's plane of motion as the camera sees it, with ``paths``: label, points
    (n, 3) in B and colour.
    """
    for label, points, colour in paths:
        axes.plot(-points[:, 1], points[:, 2], color=colour, linewidth=1.0, label=label)
    axes.set(xlabel="right / m", ylabel="up / m", title="one measurement, from behind the tool")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="best")


def _curves(axes: Axes, traced: Trace, name: str, until_s: float, scale: float, given_s: Array) -> None:
    """x, y and z over time, and a line at each input that was given."""
    shown = traced["time_s"] < until_s
    for axis, colour in enumerate(AXIS_COLOURS):
        axes.plot(
            traced["time_s"][shown], scale * traced[name][shown, axis], ".-", markersize=3, linewidth=0.8,
            color=colour, label="xyz"[axis],
        )  # fmt: skip
    axes.legend(ncols=3, frameon=True, loc="best")
    for time_s in given_s:
        axes.axvline(float(time_s), color="0.4", linewidth=0.9, linestyle=":")
    axes.set_xlabel("time / s")
