"""`longreach experiment path-information`: which calibration path tells most about where a goal will be hit.

For a map that is linear in its unknowns the information matrix depends on the path alone. It is computed for
each candidate, together with the prior, and carried to goals all round: what the path leaves unknown of them
is what counts, not the residuals along it.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.table import Table

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from nominal_arm.dimensions import boom_dimensions
from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished
from testbed.reporting.console import Columns, listed
from testbed.scenarios.arms import DEFAULT_ARM, arm_overrides
from testbed.scenarios.settings import load_settings
from vision_pc.config.programs import ProgramSettings
from vision_pc.core.calibration.backlash import before_take_up
from vision_pc.core.calibration.line_equation import circle
from vision_pc.core.calibration.local_calibration import rotation_information
from vision_pc.core.calibration.local_error_model import planned_covariance, three_legs
from vision_pc.core.calibration.trajectory_matching import asymmetric_path
from vision_pc.core.se3 import Array, transform

RATE_HZ = 10.0
SPEED_M_S = 0.25
ACCELERATION_M_S2 = 0.25
GOAL_M = 0.6
Waypoints = Callable[[Array, ProgramSettings], list[Array]]


class Track(NamedTuple):
    """Poses (n, 4, 4) at the camera's rate, the tool's speed (n,) there, and the time it takes."""

    X_BT: Array
    speed: Array
    time_s: float


def _moved(X_BT: Array, *corners: tuple[float, float, float]) -> list[Array]:
    """Waypoints at offsets along the tool's axes, and back to where it stands."""
    R, p = X_BT[:3, :3], X_BT[:3, 3]
    return [transform(R, p + R @ np.array(corner)) for corner in (*corners, (0.0, 0.0, 0.0))]


CANDIDATES: dict[str, Waypoints] = {
    "straight, 0.6 m": lambda X, s: _moved(X, (-0.6, 0.0, 0.0)),
    "circle of the line equation, 0.2 m": lambda X, s: circle(X, 0.2, 18),
    "planar, the paper's zigzag": lambda X, s: asymmetric_path(X, s.trajectory),
    "two legs, planar": lambda X, s: _moved(X, (-0.3, -0.3, 0.0), (0.0, -0.3, 0.0)),
    "three legs of 0.1 m": lambda X, s: three_legs(X, 0.1),
    "three legs of 0.2 m": lambda X, s: three_legs(X, 0.2),
    "three legs of 0.3 m": lambda X, s: three_legs(X, 0.3),
    "six legs of 0.2 m": lambda X, s: _moved(
        X, (0.0, 0.0, -0.2), (-0.2, 0.0, -0.2), (-0.2, -0.2, -0.2), (-0.2, -0.2, 0.0), (-0.2, 0.0, 0.0)
    ),
    "three legs, there and back": lambda X, s: [*three_legs(X, 0.2), *three_legs(X, 0.2)[::-1], X],
}


def simulated_track(start: Array, waypoints: list[Array], dwell_s: float) -> Track:
    """The track from ``start`` through ``waypoints``: quintic in time, at rest for ``dwell_s`` at each."""
    poses, speeds, time_s = [start], [0.0], 0.0
    for begin, end in zip([start, *waypoints], waypoints, strict=False):
        way = end[:3, 3] - begin[:3, 3]
        length = float(np.linalg.norm(way))
        duration_s = max(
            1.875 * length / SPEED_M_S, (5.7735 * length / ACCELERATION_M_S2) ** 0.5, 1.0 / RATE_HZ
        )
        for u in np.linspace(0.0, 1.0, max(round(duration_s * RATE_HZ), 1) + 1)[1:]:
            share = u**3 * (10.0 + u * (6.0 * u - 15.0))
            rate = 30.0 * u**2 * (1.0 - u) ** 2 / duration_s
            poses.append(transform(begin[:3, :3], begin[:3, 3] + share * way))
            speeds.append(rate * length)
        resting = round(dwell_s * RATE_HZ)
        poses += [end] * resting
        speeds += [0.0] * resting
        time_s += duration_s + dwell_s
    return Track(np.array(poses), np.array(speeds), time_s)


class PathSettings(NamedTuple):
    """Whose start pose and shape."""

    arm: Annotated[str, typer.Option(help="Whose start pose and shape.")] = DEFAULT_ARM


class PathRow(NamedTuple):
    """One candidate path: what it costs, and what it leaves unknown of goals all round."""

    path: str
    used: bool
    length_m: float
    time_s: float
    least_information: float
    condition: float
    goal_rms_mm: float
    goal_worst_mm: float
    failure: str = ""


Paths = Finished[PathSettings, PathRow]


def path_tasks(request: CampaignRequest, settings: PathSettings) -> list[Task]:
    """One task a candidate."""
    return [{"key": f"{settings.arm}-{name}", "path": name, "arm": settings.arm} for name in CANDIDATES]


def measured_path(config_dir: Path, task: Task) -> PathRow:
    """A candidate's information, together with the prior, carried to goals all round."""
    settings = load_settings(config_dir, arm_overrides(config_dir, task["arm"]))
    programs = settings.vision.programs
    X_BT = tool_pose(dh_table(settings.arm.dh), np.radians(settings.plant.start_pose_deg))
    boom = boom_dimensions(settings.arm)
    *corners, end = CANDIDATES[task["path"]](X_BT, programs)
    path = [*corners, before_take_up(end, programs.local_map.take_up_rad), end]
    track = simulated_track(X_BT, path, programs.local_map.dwell_s)
    covariances = planned_covariance(track.X_BT, track.speed, _goals(), boom, programs.local_map)
    worst_mm = 1e3 * np.sqrt(np.linalg.eigvalsh(covariances)[:, -1])
    turn = np.linalg.eigvalsh(rotation_information(track.X_BT[:, :3, 3], np.ones(len(track.X_BT))))
    return PathRow(
        path=task["path"],
        used=task["path"] == f"three legs of {programs.local_map.leg_m:.1f} m",
        length_m=float(np.linalg.norm(np.diff(track.X_BT[:, :3, 3], axis=0), axis=1).sum()),
        time_s=track.time_s,
        least_information=float(turn[0] / len(track.X_BT)),
        condition=float(turn[-1] / max(turn[0], 1e-12)),
        goal_rms_mm=float(np.sqrt(np.mean(worst_mm**2))),
        goal_worst_mm=float(worst_mm.max()),
    )


def path_table(done: Paths) -> list[Table]:
    """All candidates."""
    columns: Columns = {
        "path": lambda row: row.path + (" (used)" if row.used else ""),
        "length m": "{length_m:.2f}",
        "time s": "{time_s:.1f}",
        "condition": lambda row: f"{row.condition:.1f}" if row.condition < 1e6 else "∞",
        "rms mm": "{goal_rms_mm:.2f}",
        "worst mm": "{goal_worst_mm:.2f}",
    }
    return [listed(f"σ that each path leaves of a goal {GOAL_M:g} m off", columns, done.rows)]


def path_verdict(done: Paths) -> list[Check]:
    """No candidate of the used path's length and time beats it by more than a tenth."""
    used = next(row for row in done.rows if row.used)
    better = [
        row.path
        for row in done.rows
        if row.length_m <= used.length_m + 1e-3
        and row.time_s <= used.time_s + 0.1
        and row.goal_rms_mm < 0.9 * used.goal_rms_mm
    ]
    return [
        Check("paths as short that are better by a tenth", ", ".join(better) or "none", "none", not better)
    ]


PATH_INFORMATION = Experiment(
    name="path-information",
    title="What each candidate calibration path leaves unknown of a goal.",
    settings=PathSettings,
    row=PathRow,
    tasks=path_tasks,
    run=measured_path,
    table=path_table,
    verdict=path_verdict,
    world="nominal arm",
    eyes="none",
    workers=0,
)


def _goals() -> Array:
    """Steps (n, 3) in B, evenly over a sphere."""
    count = 60
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (1.0 + 5.0**0.5) * np.arange(count)
    r = np.sqrt(1.0 - z**2)
    return GOAL_M * np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
