"""`longreach arm draw`: the nominal arm from the side at its start pose, and what it reaches."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from controller.core.kinematics.denavit_hartenberg import LINKS, chain, dh_table
from nominal_arm.dimensions import boom_dimensions
from testbed.scenarios.scenario import Settings
from vision_pc.core.calibration.orientation import R_TM_NOMINAL
from vision_pc.core.se3 import apply, exp_so3, transform

_DPI = 110
_SWEEP = 60


def draw_machine(settings: Settings, path: Path) -> None:
    """Write the picture to ``path``: booms, wrist, tool, camera and object in the slewing plane, where the
    wrist can go, and the workspace of the tool.
    """
    frames = chain(dh_table(settings.arm.dh), np.radians(settings.plant.start_pose_deg))
    X_BT = np.vstack([frames[LINKS], [0.0, 0.0, 0.0, 1.0]])
    boom, target = boom_dimensions(settings.arm), settings.scene.object_of_interest
    wrist = X_BT[:3, 3] - boom.wrist_to_tool * X_BT[:3, 2]
    lift, tilt = np.array([boom.lift_pivot[0], 0.0, boom.lift_pivot[1]]), frames[2, :, 3]
    X_BO = transform(X_BT[:3, :3] @ R_TM_NOMINAL @ exp_so3(np.radians(target.tilt_deg)), target.position_m)
    camera = apply(X_BT, np.array([settings.vision.hand_eye.mount_position_m]))[0]
    edges = X_BO[:3, 3] + np.outer([-0.12, 0.28], X_BO[:3, 1])
    figure = Figure(figsize=(9.6, 7.2), layout="constrained")
    axes = figure.add_subplot(xlabel="x of B, m", ylabel="z of B, m", aspect="equal")
    _reach(axes, settings)
    axes.axhline(0.0, color="0.6", linewidth=1.0)
    parts: tuple[tuple[str, Any, dict[str, Any]], ...] = (
        ("slew", (np.zeros(3), lift), {"color": "0.45", "linewidth": 11}),
        ("lift", (lift, tilt), {"color": "goldenrod", "linewidth": 10}),
        ("tilt", (tilt, wrist), {"color": "goldenrod", "linewidth": 7}),
        ("wrist 1 to 3", (wrist, X_BT[:3, 3]), {"color": "goldenrod", "linewidth": 4}),
        ("left camera", (camera, X_BO[:3, 3]), {"color": "tab:blue", "linestyle": ":", "linewidth": 1.2}),
        ("object", edges, {"color": "0.25", "linewidth": 5}),
    )
    for name, points, style in parts:
        axes.plot(*np.array(points)[:, ::2].T, solid_capstyle="round", **style)
        at = float(points[0][0]), float(points[0][2])
        axes.annotate(
            name, at, (8, 10 if name == "left camera" else -16), textcoords="offset points", fontsize=9
        )
    axes.legend(loc="upper right", fontsize=9)
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
