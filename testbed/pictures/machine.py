"""`longreach arm draw`: the nominal arm from the side at its start pose, with its frames."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from controller.core.kinematics.denavit_hartenberg import LINKS, chain, dh_table
from nominal_arm.dimensions import boom_dimensions
from testbed.scenarios.scenario import Settings
from vision_pc.core.calibration.orientation import R_TM_NOMINAL
from vision_pc.core.se3 import Array, exp_so3, transform

_AXIS_M = 0.28
_COLOURS = ("tab:red", "tab:green", "tab:blue")
_DPI = 110
_SWEEP = 60


class _Drawn(NamedTuple):
    """One frame: its letter, what it is, its pose (4, 4) in B, and where its text stands (points)."""

    letter: str
    what: str
    X: Array
    text: tuple[float, float]


def draw_machine(settings: Settings, path: Path, reach: bool = False) -> None:
    """Write the picture to ``path``: booms, wrist, tool, camera and object in the slewing plane.

    ``reach``: also where the wrist can go, and the workspace of the tool.
    """
    frames = chain(dh_table(settings.arm.dh), np.radians(settings.plant.start_pose_deg))
    X_BT = np.vstack([frames[LINKS], [0.0, 0.0, 0.0, 1.0]])
    boom = boom_dimensions(settings.arm)
    wrist = X_BT[:3, 3] - boom.wrist_to_tool * X_BT[:3, 2]
    lift = np.array([boom.lift_pivot[0], 0.0, boom.lift_pivot[1]])
    tilt = frames[2, :, 3]
    mount = settings.vision.hand_eye
    X_BC = X_BT @ transform(np.eye(3), mount.mount_position_m)
    target = settings.scene.object_of_interest
    X_BO = transform(X_BT[:3, :3] @ R_TM_NOMINAL @ exp_so3(np.radians(target.tilt_deg)), target.position_m)
    figure = Figure(figsize=(9.6, 7.2 if reach else 4.8), layout="constrained")
    axes = figure.add_subplot()
    if reach:
        _reach(axes, settings)
    draw_steel(axes, lift, tilt, wrist, X_BT)
    draw_object(axes, X_BC, X_BO)
    for drawn in (
        _Drawn("B", "base", np.eye(4), (-52.0, -16.0)),
        _Drawn("T", "tool centre point", X_BT, (-60.0, -62.0)),
        _Drawn("C", "left camera", X_BC, (-84.0, -52.0)),
        _Drawn("M", "tool marker, at T", X_BT @ transform(R_TM_NOMINAL, np.zeros(3)), (-30.0, 46.0)),
        _Drawn("O", "object of interest", X_BO, (-40.0, -52.0)),
    ):
        _frame(axes, drawn)
    axes.set(xlabel="x of B, m", ylabel="z of B, m", aspect="equal")
    if reach:
        axes.legend(loc="upper right", fontsize=9)
    else:
        axes.set(xlim=(-0.8, max(5.4, X_BO[0, 3] + 0.8)), ylim=(-0.35, max(2.55, tilt[2] + 0.45)))
    axes.grid(color="0.92")
    axes.set_axisbelow(True)
    figure.savefig(path, dpi=_DPI)


def _reach(axes: Axes, settings: Settings) -> None:
    """The edge of what lift and tilt reach with the wrist's centre, and the box of the tool's workspace."""
    table, (_, lift, tilt, *_) = dh_table(settings.arm.dh), settings.arm.joints
    lifts, tilts = (np.linspace(j.lower_deg, j.upper_deg, _SWEEP) for j in (lift, tilt))
    ends = np.ones(_SWEEP)
    swept = [
        *zip(lifts, ends * tilt.upper_deg, strict=True),
        *zip(ends * lift.upper_deg, tilts[::-1], strict=True),
        *zip(lifts[::-1], ends * tilt.lower_deg, strict=True),
        *zip(ends * lift.lower_deg, tilts, strict=True),
    ]
    edge = np.array([chain(table, np.radians([0.0, a, b, 0.0, 0.0, 0.0]))[4, :, 3] for a, b in swept])
    axes.fill(edge[:, 0], edge[:, 2], color="tab:green", alpha=0.12, label="reach of the wrist's centre")
    box = settings.arm.workspace
    corner, size = (box.x_m[0], box.z_m[0]), (box.x_m[1] - box.x_m[0], box.z_m[1] - box.z_m[0])
    axes.add_patch(Rectangle(corner, *size, fill=False, linestyle="--", color="0.4", label="workspace of T"))


def draw_steel(axes: Axes, lift: Array, tilt: Array, wrist: Array, X_BT: Array) -> None:
    """Pillar, boom, arm and wrist between their pivots (3,) and the tool (4, 4), from the side."""
    axes.axhline(0.0, color="0.6", linewidth=1.0)
    axes.plot(
        [0.0, 0.0, lift[0]],
        [0.0, 0.55 * lift[2], lift[2]],
        color="0.45",
        linewidth=11,
        solid_capstyle="round",
    )
    for begin, end, width in ((lift, tilt, 10), (tilt, wrist, 7), (wrist, X_BT[:3, 3], 4)):
        axes.plot(
            *zip(begin[::2], end[::2], strict=True),
            color="goldenrod",
            linewidth=width,
            solid_capstyle="round",
        )
    for joint, name, offset in (
        (lift, "lift", (-34, 4)),
        (tilt, "tilt", (-8, 12)),
        (wrist, "wrist 1 to 3", (-76, -18)),
    ):
        axes.plot(joint[0], joint[2], "o", color="0.2", markersize=6)
        axes.annotate(name, _side(joint), offset, textcoords="offset points", color="0.3", fontsize=9)
    axes.annotate("slew", (0.0, 0.25), (10, 0), textcoords="offset points", color="0.3", fontsize=9)


def draw_object(axes: Axes, X_BC: Array, X_BO: Array) -> None:
    """The object's plate and the camera's view of it, from the side; poses (4, 4) in B."""
    plate = X_BO[:3, 3][:, None] + np.outer(X_BO[:3, 1], [-0.12, 0.28])
    axes.plot(plate[0], plate[2], color="0.25", linewidth=5)
    axes.plot(
        *zip(X_BC[:3, 3][::2], X_BO[:3, 3][::2], strict=True), color="tab:blue", linestyle=":", linewidth=1.2
    )


def _frame(axes: Axes, drawn: _Drawn) -> None:
    """The frame's axes as they are seen from the side: x red, y green, z blue."""
    p = drawn.X[:3, 3]
    for axis, colour in enumerate(_COLOURS):
        along = _AXIS_M * drawn.X[:3, axis]
        if np.hypot(along[0], along[2]) > 0.2 * _AXIS_M:
            axes.annotate(
                "",
                _side(p + along),
                _side(p),
                arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.8},
            )
    axes.annotate(
        f"$\\bf{{{drawn.letter}}}$ {drawn.what}",
        _side(p),
        drawn.text,
        textcoords="offset points",
        fontsize=10,
        arrowprops={"arrowstyle": "-", "color": "0.6", "linewidth": 0.7},
    )


def _side(p: Array) -> tuple[float, float]:
    """``p`` (3,) as it is seen from the side: x and z."""
    return float(p[0]), float(p[2])
