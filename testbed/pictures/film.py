"""`longreach picture run`: one run as an animation: the arm from the side, its camera, the true error."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from numpy.typing import NDArray
from PIL import Image

from controller.core.kinematics.denavit_hartenberg import chain, dh_table
from nominal_arm.dimensions import boom_dimensions
from plant_emulator.core.truth import PlantTruth, tool_error
from testbed.demonstration.sequence import Recorder, Rest, demonstrate
from testbed.lockstep.camera_side import Exposure
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.world import VISION_CLOCK_NS
from testbed.pictures.machine import draw_object, draw_steel
from testbed.reporting.console import Bars
from testbed.scenarios.scenario import Settings
from vision_pc.core.se3 import Array

EVERY_NS = 800_000_000  # of the run; longer while nothing moves would hide how long a look takes
SHOWN_MS = 90
LAST_MS = 3000  # the end is to be read
_PICTURE_PX = (448, 252)
_SIZE_IN, _DPI = (9.2, 4.4), 80
_QUALITY = 70  # a quarter of what a GIF of 96 colours takes
_WORST_MM, _LEAST_MM = 1000.0, 0.1
_WITHIN_MM = 5.0


class Still(NamedTuple):
    """One instant: what was true, and the left picture, small."""

    truth: PlantTruth
    picture: NDArray[np.uint8]


def filmed(settings: Settings, seed: int, looks: int, shown: Bars) -> tuple[list[Still], list[Rest]]:
    """The demonstration in lockstep, with a still every ``EVERY_NS``, and where it rested.

    Raises LongreachError where a step fails.
    """
    rig = LockstepRig(settings, seed, RunLog())
    stills: list[Still] = []

    def watch(exposure: Exposure) -> None:
        if exposure.truth.time_ns % EVERY_NS == 0:
            left = rig.world.camera.photograph(exposure).left
            small = cv2.resize(left, _PICTURE_PX, interpolation=cv2.INTER_AREA)
            stills.append(Still(exposure.truth, np.asarray(small, np.uint8)))

    rig.world.camera.viewers.append(watch)
    recorder = Recorder(rig, shown)
    demonstrate(rig, recorder, looks)
    return stills, recorder.rests


def write_film(settings: Settings, stills: Sequence[Still], rests: Sequence[Rest], path: Path) -> None:
    """Write the animation to ``path``: WebP, or GIF, by its name."""
    clearance_m = settings.vision.programs.positioning.clearance_m
    errors = np.array([_error_mm(still.truth, clearance_m) for still in stills])
    frames = [_frame(settings, stills, errors, number, rests) for number in range(len(stills))]
    shown_ms = [SHOWN_MS] * (len(frames) - 1) + [LAST_MS]
    first, *others = frames
    first.save(path, save_all=True, append_images=others, duration=shown_ms, loop=0, quality=_QUALITY)


def _error_mm(truth: PlantTruth, clearance_m: float) -> float:
    """The worse of |x| and |y|, by which a run is judged."""
    return float(1e3 * np.abs(tool_error(truth, clearance_m)[:2]).max())


def _frame(
    settings: Settings, stills: Sequence[Still], errors: Array, number: int, rests: Sequence[Rest]
) -> Image.Image:
    figure = Figure(figsize=_SIZE_IN, dpi=_DPI, layout="constrained")
    side, seen, error = (figure.add_subplot(place) for place in _places(figure))
    truth, picture = stills[number]
    _side(side, settings, truth)
    seen.imshow(picture, cmap="gray", vmin=0, vmax=255)
    seen.set_axis_off()
    seen.set_title("what the camera sees", fontsize=9)
    _errors(error, [1e-9 * still.truth.time_ns for still in stills], errors, number)
    figure.suptitle(f"{_doing(truth.time_ns, rests)}, {1e-9 * truth.time_ns:.0f} s", fontsize=11)
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    return Image.open(drawn).convert("RGB")


def _places(figure: Figure) -> tuple[SubplotSpec, SubplotSpec, SubplotSpec]:
    grid = figure.add_gridspec(2, 2, width_ratios=[1.25, 1.0], height_ratios=[1.25, 1.0])
    return grid[:, 0], grid[0, 1], grid[1, 1]


def _side(axes: Axes, settings: Settings, truth: PlantTruth) -> None:
    frames = chain(dh_table(settings.arm.dh), truth.q)
    boom = boom_dimensions(settings.arm)
    wrist = truth.X_BT[:3, 3] - boom.wrist_to_tool * truth.X_BT[:3, 2]
    lift = np.array([boom.lift_pivot[0], 0.0, boom.lift_pivot[1]])
    draw_steel(axes, lift, frames[2, :, 3], wrist, truth.X_BT)
    inverse_WB = np.linalg.inv(truth.X_WB)
    draw_object(axes, inverse_WB @ truth.X_WC, inverse_WB @ truth.X_WO)
    axes.set(xlim=(-0.9, 5.2), ylim=(-0.35, 3.0), aspect="equal", xlabel="x of B, m", ylabel="z of B, m")
    axes.set_title("the true arm, from the side", fontsize=9)


def _errors(axes: Axes, times: list[float], errors: Array, number: int) -> None:
    axes.axhspan(_LEAST_MM, _WITHIN_MM, color="tab:green", alpha=0.15)
    axes.semilogy(times[: number + 1], np.maximum(errors[: number + 1], _LEAST_MM), color="tab:blue")
    axes.plot(times[number], max(errors[number], _LEAST_MM), "o", color="tab:blue")
    axes.set(xlim=(0.0, times[-1]), ylim=(_LEAST_MM, _WORST_MM), xlabel="s", ylabel="true error, mm")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_title(f"{errors[number]:.1f} mm left in x and y", fontsize=9)


def _doing(time_ns: int, rests: Sequence[Rest]) -> str:
    later = (rest.label for rest in rests if rest.time_ns - VISION_CLOCK_NS >= time_ns)
    return next(later, rests[-1].label)
