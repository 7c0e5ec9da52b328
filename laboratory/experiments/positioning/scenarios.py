"""Scenarios of drawn worlds: drawn wide, and only kept where the task can be done at all.

A draw is kept when tool marker and object are in view from the start, with the tool turned parallel to the
object, and when the arm reaches the goal with room to spare. Everything else is left as drawn.
"""

import math
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from controller.core.kinematics.inverse_kinematics import REACHED, joint_angles
from foundation.configuration import merged
from laboratory.experiments.positioning.axes import JSON
from laboratory.experiments.positioning.worlds import ARMS, DrawnWorld, drawn
from nominal_arm.description import NominalArm
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.exposures import CameraView, Capture
from plant_emulator.core.camera.scene import R_WO_FACING_ARM, Scene
from protocol.errors import ConfigurationError
from testbed.lockstep.true_view import TrueView
from testbed.scenarios.arms import DEFAULT_ARM, arm_overrides
from testbed.scenarios.scenario import Settings, load_settings
from vision_pc.core.se3 import Array, exp_so3, inverse, log_so3, transform

_TRIES = 20_000
_STREAM = 0x62657374
_JOINT_MARGIN = math.radians(4.0)  # the path's legs and the controller's own margins
_WRIST_BENT = math.radians(6.0)  # the controller refuses a wrist that is stretched: singular below 2.9°
_CLEARANCE_M = 0.1
_RIM_PX = 12.0


class Drawn(NamedTuple):
    """One scenario: overrides of the configuration files, and what a table wants to show of it."""

    overrides: JSON
    shown: JSON


class _Pose(NamedTuple):
    """Start pose and object, in the base of the nominal arm."""

    start_deg: list[float]
    X_WT: Array
    X_WO: Array
    X_TC: Array
    distance_m: float


def draw(config_dir: Path, seed: int, arm: str, world: DrawnWorld, unturned: Array | None = None) -> Drawn:
    """The scenario of ``seed`` on ``arm``, a name of ``arms/`` or a directory.

    ``unturned``: places (n, 3) in O that the tool is driven to as it stands, not turned parallel to the
    object; they are within reach too. Raises ConfigurationError for an unknown arm, or when no draw of many
    can be done.
    """
    files = arm_overrides(config_dir, arm)
    settings = load_settings(config_dir, files)
    stream = _stream(arm)
    beside = drawn(world, seed, stream, settings)
    usual = load_settings(config_dir, merged(files, beside))
    rng = np.random.default_rng([seed, _STREAM, stream])
    leg_m = settings.vision.programs.local_map.leg_m
    for _ in range(_TRIES):
        pose = _draw_pose(rng, settings)
        scene = merged(_scene(rng, pose), beside.get("scene", {}))
        if _can_reach(pose, settings.arm, _goals(pose, leg_m, unturned)) and _in_view(
            pose, usual.scene, scene
        ):
            break
    else:
        why = f"seed {seed}: none of {_TRIES} draws can be done"
        raise ConfigurationError("configuration.no_scenario", why)
    plant = merged(_plant(rng, pose), beside.get("plant", {}))
    overrides = merged(merged(files, beside), {"scene": scene, "plant": plant})
    shown = {
        "payload_kg": plant["payload"]["mass_kg"],
        "mount_deg": float(np.linalg.norm(scene["mount"]["rotation_deg"])),
        "lever_m": float(np.linalg.norm(scene["mount"]["position_m"])),
        "distance_m": pose.distance_m,
        "disparity_px": scene["camera"]["rectification"]["disparity_px"],
    }
    return Drawn(overrides, shown)


def _stream(arm: str) -> int:
    """What tells the draws of one arm from those of another."""
    former = dict.fromkeys((ARMS[0], DEFAULT_ARM), 0) | dict.fromkeys((ARMS[1], "long_crane"), 1)
    return former.get(arm, crc32(Path(arm).name.encode()))


def _draw_pose(rng: np.random.Generator, settings: Settings) -> _Pose:
    """Start pose around the configured one with the tool level, mount, and an object somewhere in front."""
    start = np.array(settings.plant.start_pose_deg)
    start[1] += rng.uniform(-8.0, 8.0)
    start[2] += rng.uniform(-25.0, 2.0)
    start[4] = start[1] + start[2]
    X_WT = tool_pose(dh_table(settings.arm.dh), np.radians(start))
    rotation = _ball(rng, math.radians(20.0))
    position = rng.uniform([-0.35, -0.25, -0.5], [0.35, 0.25, -0.25])
    while np.linalg.norm(position) > 0.5:
        position = rng.uniform([-0.35, -0.25, -0.5], [0.35, 0.25, -0.25])
    direction = _ball(rng, 1.0)
    distance = rng.uniform(0.3, 1.2)
    offset = distance * direction / np.linalg.norm(direction)
    facing = R_WO_FACING_ARM @ exp_so3(_ball(rng, math.radians(8.0)))
    p_WO = X_WT[:3, 3] + offset - 0.1 * facing[:, 2]
    return _Pose(
        start.tolist(), X_WT, transform(facing, p_WO), transform(exp_so3(rotation), position), distance
    )


def _ball(rng: np.random.Generator, radius: float) -> Array:
    """Evenly in a ball: half of all vectors are longer than 0.79 of its radius."""
    direction = rng.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction) * radius * np.cbrt(rng.uniform(0.0, 1.0)))


def _scene(rng: np.random.Generator, pose: _Pose) -> JSON:
    tilt = R_WO_FACING_ARM.T @ pose.X_WO[:3, :3]
    return {
        "seed": int(rng.integers(2**31)),
        "wall": {"texture_seed": int(rng.integers(2**31))},
        "mount": {
            "position_m": pose.X_TC[:3, 3].tolist(),
            "rotation_deg": np.degrees(log_so3(pose.X_TC[:3, :3])).tolist(),
        },
        "tool_marker": {
            "misalignment_deg": np.degrees(_ball(rng, math.radians(1.5))).tolist(),
            "offset_m": _ball(rng, 0.002).tolist(),
        },
        "object_of_interest": {
            "position_m": pose.X_WO[:3, 3].tolist(),
            "tilt_deg": np.degrees(log_so3(tilt)).tolist(),
        },
        "camera": {
            "rectification": {
                "disparity_px": rng.uniform(-0.5, 0.5),
                "vertical_px": rng.uniform(-0.5, 0.5),
            }
        },
    }


def _plant(rng: np.random.Generator, pose: _Pose) -> JSON:
    return {
        "start_pose_deg": pose.start_deg,
        "payload": {"mass_kg": rng.uniform(0.0, 150.0)},
        "errors": {
            "encoder_offsets": {"mrad": rng.uniform(-5.0, 5.0, 6).tolist()},
            "geometry": {
                "lift": {"offset_mm": _ball(rng, 3.0).tolist()},
                "tilt": {"offset_mm": _ball(rng, 3.0).tolist()},
                "wrist1": {"offset_mm": _ball(rng, 3.0).tolist()},
                "tool": {"tilt_mrad": _ball(rng, 3.0).tolist()},
            },
            "base_tilt": {"x_mrad": rng.uniform(-5.0, 5.0), "y_mrad": rng.uniform(-5.0, 5.0)},
        },
    }


def _goal(pose: _Pose, X_TM: Array) -> tuple[Array, Array]:
    """X_WT turned parallel to the object where it stands, and at the object with clearance."""
    R_WT = pose.X_WO[:3, :3] @ X_TM[:3, :3].T
    turned = transform(R_WT, pose.X_WT[:3, 3])
    clearance = R_WT @ pose.X_TC[:3, 2] * _CLEARANCE_M  # along the camera's axis
    return turned, transform(R_WT, pose.X_WO[:3, 3] - clearance)


def _goals(pose: _Pose, leg_m: float, unturned: Array | None) -> list[Array]:
    """X_WT that are driven to: turned parallel, ``leg_m`` behind that along each axis, at ``unturned``
    places, and last at the object.
    """
    turned, goal = _goal(pose, transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3)))
    back = turned.copy()
    back[:3, 3] -= turned[:3, :3] @ np.full(3, leg_m)
    clearance = (pose.X_WT @ pose.X_TC)[:3, 2] * _CLEARANCE_M
    places = np.zeros((0, 3)) if unturned is None else unturned
    tools = places @ pose.X_WO[:3, :3].T + pose.X_WO[:3, 3] - clearance
    return [turned, back, *(transform(pose.X_WT[:3, :3], p_WT) for p_WT in tools), goal]


def _can_reach(pose: _Pose, arm: NominalArm, goals: list[Array]) -> bool:
    table, branch = dh_table(arm.dh), np.radians(pose.start_deg)
    low, high = np.radians([[joint.lower_deg, joint.upper_deg] for joint in arm.joints]).T
    least, most = np.transpose([arm.workspace.x_m, arm.workspace.y_m, arm.workspace.z_m])
    for X in goals:
        verdict, q, _, _ = joint_angles(table, X[:3, :3].copy(), X[:3, 3].copy(), branch)
        turns = np.all((q >= low + _JOINT_MARGIN) & (q <= high - _JOINT_MARGIN)) and abs(q[4]) >= _WRIST_BENT
        if verdict != REACHED or not turns or not np.all((least + 0.1 < X[:3, 3]) & (X[:3, 3] < most - 0.1)):
            return False
    # what bends downwards must still be within the boom's reach
    stretched = goals[-1].copy()
    stretched[:3, 3] += 0.1 * stretched[:3, 3] / np.linalg.norm(stretched[:3, 3])
    return bool(joint_angles(table, stretched[:3, :3].copy(), stretched[:3, 3].copy(), branch)[0] == REACHED)


def _in_view(pose: _Pose, usual: SceneConfig, drawn: JSON) -> bool:
    """Whether both eyes see all markers at the start and turned, and tool and object at the goal."""
    for p_C in (inverse(pose.X_TC)[:3, 3], (inverse(pose.X_WT @ pose.X_TC) @ pose.X_WO)[:3, 3]):
        if p_C[2] < 0.2 or np.any(np.abs(p_C[:2]) > p_C[2] * np.array([1.3, 0.8])):
            return False  # seen at a glance: far cheaper than a scene
    config = SceneConfig.model_validate(merged(usual.model_dump(), drawn))
    scene = Scene(config)
    view = TrueView(config.camera, scene, rim_px=_RIM_PX)
    turned, goal = _goal(pose, scene.mounts.X_TM)
    for X_WT in (pose.X_WT, turned):
        seen = view.markers(_still(X_WT, scene, pose.X_TC))
        if any(s.left is None or s.right is None for s in seen.values()):
            return False
    seen = view.markers(_still(goal, scene, pose.X_TC))
    tool = config.tool_marker.marker_id
    return seen[tool].left is not None and any(
        s.left is not None and s.right is not None for number, s in seen.items() if number != tool
    )


def _still(X_WT: Array, scene: Scene, X_TC: Array) -> Capture:
    """What the camera shows with the tool at rest at ``X_WT``."""
    return Capture(0, 0, CameraView(X_WT @ X_TC, X_WT @ scene.mounts.X_TM))
