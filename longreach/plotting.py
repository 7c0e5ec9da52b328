"""Looks and runs as figures."""

import io
from functools import singledispatch
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle

from longreach.rigs import SimulatedRig
from plant_emulator.core.truth import tool_error
from protocol.errors import RequestRefused
from testbed.reporting.plots import AXIS_COLOURS, STYLE
from vision_pc.application.results import JudgedLook
from vision_pc.core.positioning.expected_end import expected_end


class Plot(Figure):
    """A figure that a notebook shows by itself, with or without pyplot."""

    def _repr_png_(self) -> bytes:
        made = io.BytesIO()
        self.savefig(made, format="png")
        return made.getvalue()


@singledispatch
def plot(what: Any) -> Plot:
    """A figure of a look (error, 95 % ellipse, tolerance) or of a simulated rig's run (true error over time).

    Raises RequestRefused (``request.invalid``) for anything else.
    """
    raise RequestRefused("request.invalid", f"plot: {type(what).__name__}: wanted a look or a simulated rig")


@plot.register(JudgedLook)
def _look(what: JudgedLook) -> Plot:
    """Error and ellipse in the camera's x-y plane, y down as in the picture, inside the tolerance or not."""
    verdict = what.verdict
    x, y, z = 1e3 * verdict.error_m
    limit = 1e3 * verdict.tolerance_m
    major, minor, angle = expected_end(verdict.error_m, verdict.covariance, verdict.tolerance_m).ellipse
    reach = 1.15 * max(limit, abs(x) + 1e3 * major, abs(y) + 1e3 * major)
    with matplotlib.rc_context(STYLE):
        figure = Plot(figsize=(4.6, 4.6), layout="constrained")
        axes = figure.subplots()
        axes.add_patch(Rectangle((-limit, -limit), 2 * limit, 2 * limit, color="0.5", alpha=0.2, linewidth=0))
        axes.add_patch(Ellipse((x, y), 2e3 * major, 2e3 * minor, angle=np.degrees(angle), fill=False))
        axes.plot(x, y, "x", color=AXIS_COLOURS[0])
        axes.set(xlim=(-reach, reach), ylim=(reach, -reach), xlabel="x / mm (right)", ylabel="y / mm (down)")
        axes.set_aspect("equal")
        axes.set_title(f"shaded: ±{limit:g} mm wanted; z {z:+.1f} mm", loc="left")
    return figure


@plot.register(SimulatedRig)
def _run(what: SimulatedRig) -> Plot:
    """The tool's true error at the object, camera axes, since the rig was made."""
    world = what.lockstep_rig.world
    clearance_m = world.settings.vision.programs.positioning.clearance_m
    time_s = np.array([1e-9 * truth.time_ns for truth in world.truths])
    error_mm = 1e3 * np.array([tool_error(truth, clearance_m) for truth in world.truths]).reshape(-1, 3)
    with matplotlib.rc_context(STYLE):
        figure = Plot(figsize=(8.0, 3.2), layout="constrained")
        axes = figure.subplots()
        for axis, colour in enumerate(AXIS_COLOURS):
            axes.plot(time_s, error_mm[:, axis], color=colour, label="xyz"[axis])
        axes.set(xlabel="simulated time / s", ylabel="true error / mm")
        axes.legend(ncols=3, loc="upper right")
    return figure
