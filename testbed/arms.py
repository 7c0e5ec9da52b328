"""Whether a directory describes an arm that can run, and a directory to begin one's own from."""

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from controller.core.kinematics.denavit_hartenberg import chain, dh_table, geometric_jacobian, tool_pose
from controller.core.kinematics.inverse_kinematics import REACHED, joint_angles
from foundation.configuration import BASE_FILE, configuration_hash
from nominal_arm.description import JOINT_NAMES, CylinderDrive
from nominal_arm.dimensions import boom_dimensions
from plant_emulator.config.actuators import CylinderConfig
from plant_emulator.core.camera.scene import R_TM_NOMINAL, R_WO_FACING_ARM
from protocol.errors import ConfigurationError
from testbed.reporting.checks import HealthCheck, Verdict
from testbed.scenarios.scenario import Settings
from vision_pc.core.se3 import exp_so3

_OF_ONE_ARM = {
    "arm": ("dh", "joints", "drives", "rated", "workspace"),
    "plant": ("start_pose_deg", "geometry", "masses", "flexibility", "actuators"),
    "scene": ("object_of_interest.position_m",),
}
_NOTE = "# Copied from {like}, to be edited. What is left out here is as in the directory of base.yaml.\n"


def begin_arm(directory: Path, like: Path, settings: Settings) -> list[Path]:
    """Write an arm over ``like``, whose configuration is ``settings``, into ``directory``; the files.

    Raises ConfigurationError when the directory is there and not empty.
    """
    if directory.is_dir() and any(directory.iterdir()):
        raise ConfigurationError("configuration.not_empty", f"{directory} is there and holds files")
    directory.mkdir(parents=True, exist_ok=True)
    below = os.path.relpath(like.resolve(), directory.resolve())
    written = [_write(directory / BASE_FILE, like, {"over": below})]
    for stem, keys in _OF_ONE_ARM.items():
        whole = getattr(settings, stem).model_dump(mode="json", exclude_none=True)
        chosen: dict[str, Any] = {"name": directory.resolve().name} if stem == "arm" else {}
        for key in keys:
            first, _, second = key.partition(".")
            chosen[first] = {second: whole[first][second]} if second else whole[first]
        written.append(_write(directory / f"{stem}.yaml", like, chosen))
    return written


def _write(path: Path, like: Path, content: dict[str, Any]) -> Path:
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)
    path.write_text(_NOTE.format(like=like) + text, encoding="utf-8")
    return path


_LENGTH_M = 0.02  # [D] of a tape measure along a boom; beyond it is another arm
_ANGLE_DEG = 1.2  # [D] 20 mrad
_SPEED = 0.15  # [D] of full spool: what commissioning starts from
_MARGIN_DEG = 5.0  # [D] from a joint's end where work begins
_STRETCHED_DEG = 6.0  # [D] wrist 2 at 0 is the wrist's singularity
_KG_M = (20.0, 2000.0)  # [D] of moving steel a metre of reach: no such arm is lighter or heavier
_L_MIN = 1.0 / 60_000.0


def check_arm(settings: Settings) -> list[HealthCheck]:
    """All findings about the arm of ``settings``, in the order in which they are best mended."""
    return [
        HealthCheck("hash", "ok", f"{configuration_hash(settings.arm):#018x}, which a PLC announces"),
        *_lengths(settings),
        *_linkages(settings),
        *_speeds(settings),
        *_ranges(settings),
        _weight(settings),
        *_start(settings),
        _goal(settings),
    ]


def _compare(name: str, drawn: float, built: float, unit: str, most: float, where: str) -> HealthCheck:
    found = f"drawn {drawn:.4g}{unit}, built {built:.4g}{unit}"
    if abs(drawn - built) <= most:
        return HealthCheck(name, "ok", found)
    return HealthCheck(name, "failed", found, f"they may differ by {most:.2g}{unit}: {where}")


def _lengths(settings: Settings) -> Iterator[HealthCheck]:
    dh, true = settings.arm.dh, settings.plant.geometry
    boom = boom_dimensions(settings.arm)
    rows = (
        ("lift pivot, forward", dh[0].a_m, true.lift_pivot_m[0], "arm.dh.0.a_m, plant.geometry.lift_pivot_m"),
        ("lift pivot, up", dh[0].d_m, true.lift_pivot_m[1], "arm.dh.0.d_m, plant.geometry.lift_pivot_m"),
        ("boom", boom.boom, math.hypot(*true.tilt_pivot_m), "arm.dh.1.a_m, plant.geometry.tilt_pivot_m"),
        ("boom tip, up", dh[2].a_m, true.boom_tip_m[1], "arm.dh.2.a_m, plant.geometry.boom_tip_m"),
        (
            "forearm with telescope",
            dh[3].d_m,
            true.boom_tip_m[0] + true.telescope_m,
            "arm.dh.3.d_m, plant.geometry.boom_tip_m and telescope_m",
        ),
        ("tool", boom.wrist_to_tool, true.tool_length_m, "−arm.dh.5.d_m, plant.geometry.tool_length_m"),
    )
    for name, drawn, built, where in rows:
        yield _compare(name, drawn, built, " m", _LENGTH_M, where)
    bent = math.degrees(math.atan2(true.tilt_pivot_m[1], true.tilt_pivot_m[0]))
    for row, built in ((1, bent), (2, 90.0 - bent)):
        where = f"arm.dh.{row}.theta_offset_deg, plant.geometry.tilt_pivot_m"
        drawn = dh[row].theta_offset_deg
        yield _compare(f"zero of {dh[row].name}", drawn, built, "°", _ANGLE_DEG, where)


def _linkages(settings: Settings) -> Iterator[HealthCheck]:
    for name, drive in zip(JOINT_NAMES, settings.arm.drives, strict=True):
        true = getattr(settings.plant.actuators, name).cylinder
        if (true is None) == isinstance(drive, CylinderDrive):
            kinds = ("a vane", "a cylinder")
            drawn, built = kinds[isinstance(drive, CylinderDrive)], kinds[true is not None]
            advice = "arm.drives.kind and plant.actuators must say the same"
            yield HealthCheck(f"{name}'s drive", "failed", f"drawn {drawn}, built {built}", advice)
        elif isinstance(drive, CylinderDrive):
            where = f"arm.drives of {name}, plant.actuators.{name}.cylinder"
            yield _compare(f"{name}'s long side", drive.long_m, true.base_m, " m", _LENGTH_M, where)
            yield _compare(f"{name}'s short side", drive.short_m, true.lever_m, " m", _LENGTH_M, where)
            offsets = math.degrees(drive.angle_offset_rad), -math.degrees(true.angle_rad)
            yield _compare(f"{name}'s angle offset", *offsets, "°", _ANGLE_DEG, where)
            built_ratio = 1.0 - (true.rod_mm / true.bore_mm) ** 2
            yield _compare(f"{name}'s area ratio", drive.area_ratio, built_ratio, "", 0.05, where)


def _speeds(settings: Settings) -> Iterator[HealthCheck]:
    """Full-spool speeds without load, from rated flow and areas, at the pressures that the drawing names."""
    rated, drop = settings.arm.rated, settings.plant.valves.rated_drop_bar
    for name, drive in zip(JOINT_NAMES, settings.arm.drives, strict=True):
        actuator = getattr(settings.plant.actuators, name)
        gain = actuator.rated_flow_l_min * _L_MIN / math.sqrt(drop)
        pairs: tuple[tuple[str, float, float, str], ...]
        if isinstance(drive, CylinderDrive):
            if actuator.cylinder is None:
                continue  # told above
            out, back = _cylinder_speeds(actuator.cylinder, gain, rated.supply_bar, rated.return_bar)
            pairs = (("extend", drive.extend_m_s, out, " m/s"), ("retract", drive.retract_m_s, back, " m/s"))
        else:
            if actuator.rotary is None:
                continue
            across = math.sqrt(0.5 * (rated.supply_bar - rated.return_bar))
            speed = gain * across / actuator.rotary.displacement_m3_rad
            pairs = (("turn", drive.speed_rad_s, speed, " rad/s"),)
        for way, drawn, built, unit in pairs:
            where = f"arm.drives of {name}, plant.actuators.{name}.rated_flow_l_min"
            yield _compare(f"{name}, full spool, {way}", drawn, built, unit, _SPEED * built, where)


def _cylinder_speeds(
    cylinder: CylinderConfig, gain: float, supply: float, back: float
) -> tuple[float, float]:
    """Free speeds out and in: what both edges pass with equal forces on both sides of the piston."""
    ratio = 1.0 - (cylinder.rod_mm / cylinder.bore_mm) ** 2
    k = gain / (math.pi / 4.0 * (1e-3 * cylinder.bore_mm) ** 2)
    extend = k * math.sqrt((supply - ratio * back) / (1.0 + ratio**3))
    retract = k * math.sqrt((supply - back / ratio) / (ratio**2 + 1.0 / ratio))
    return extend, retract


def _ranges(settings: Settings) -> Iterator[HealthCheck]:
    """The drawn range of every joint lies between the machine's stops."""
    for joint in settings.arm.joints:
        actuator = getattr(settings.plant.actuators, joint.name)
        turning, cylinder = actuator.rotary, actuator.cylinder
        low, high = _stops(cylinder) if cylinder else (turning.from_deg, turning.to_deg)
        found = f"{joint.lower_deg:g} to {joint.upper_deg:g}°, stops at {low:.1f} and {high:.1f}°"
        inside = low - 0.2 <= joint.lower_deg and joint.upper_deg <= high + 0.2
        advice = "" if inside else f"arm.joints of {joint.name}: the machine is stopped before its limit"
        yield HealthCheck(f"{joint.name}'s range", "ok" if inside else "failed", found, advice)


def _stops(cylinder: CylinderConfig) -> tuple[float, float]:
    """The joint's angles (deg) with the cylinder in and out, the lower first."""

    def angle(length: float) -> float:
        cosine = (length**2 - cylinder.base_m**2 - cylinder.lever_m**2) / (
            2.0 * cylinder.base_m * cylinder.lever_m
        )
        return math.degrees(cylinder.angle_rad - math.acos(max(-1.0, min(1.0, cosine))))

    ends = angle(cylinder.length_m), angle(cylinder.length_m + cylinder.stroke_m)
    return min(ends), max(ends)


def _weight(settings: Settings) -> HealthCheck:
    """Kilograms and metres: steel a metre of reach."""
    masses, boom = settings.plant.masses, boom_dimensions(settings.arm)
    bars, wrist = (*masses.boom, *masses.arm, *masses.telescope), (masses.wrist1, masses.wrist2, masses.tool)
    total = sum(bar.mass_kg for bar in bars) + sum(body.mass_kg for body in wrist)
    reach = boom.boom + boom.forearm + boom.wrist_to_tool
    low, high = (limit * reach for limit in _KG_M)
    found = f"{total:.0f} kg move, {reach:.2f} m from lift pivot to tool, stretched"
    if low <= total <= high:
        return HealthCheck("units", "ok", found)
    return HealthCheck("units", "warning", found, f"{low:.0f} to {high:.0f} kg are usual: kilograms, metres?")


def _start(settings: Settings) -> Iterator[HealthCheck]:
    """The pose that work begins at: inside every range and the workspace, away from singularities."""
    arm, start = settings.arm, settings.plant.start_pose_deg
    key = "plant.start_pose_deg"
    for joint, at in zip(arm.joints, start, strict=True):
        room = min(at - joint.lower_deg, joint.upper_deg - at)
        if room < _MARGIN_DEG:
            why = f"{at:g}° of {joint.lower_deg:g} to {joint.upper_deg:g}°"
            advice = f"{key}: {_MARGIN_DEG:g}° from either end"
            yield HealthCheck(f"start, {joint.name}", "failed", why, advice)
    table, q = dh_table(arm.dh), np.radians(start)
    least = float(np.linalg.svd(geometric_jacobian(chain(table, q)), compute_uv=False)[-1])
    wanted = settings.controller.motion.singular_value_min
    away = least > wanted and abs(start[4]) >= _STRETCHED_DEG
    advice = "" if away else f"{key}: wrist 2 further than {_STRETCHED_DEG:g}° from 0, elbow bent"
    found = f"least singular value {least:.3f}, refused below {wanted:g}; wrist 2 at {start[4]:g}°"
    yield HealthCheck("start, singularities", "ok" if away else "failed", found, advice)
    p = tool_pose(table, q)[:3, 3]
    yield HealthCheck("start, workspace", *_in_workspace(settings, p, key))


def _in_workspace(settings: Settings, p: NDArray[np.float64], key: str) -> tuple[Verdict, str, str]:
    box = settings.arm.workspace
    limits = zip("xyz", p, (box.x_m, box.y_m, box.z_m), strict=True)
    outside = [
        f"{axis} = {at:.2f} m of {low:g} to {high:g}"
        for axis, at, (low, high) in limits
        if not low <= at <= high
    ]
    found = f"({p[0]:.2f}, {p[1]:.2f}, {p[2]:.2f}) m"
    if not outside:
        return "ok", found, ""
    return "failed", f"{found}: {'; '.join(outside)}", f"arm.workspace, or {key}"


def _goal(settings: Settings) -> HealthCheck:
    """Whether the tool can stand at the object, as the drawing has the arm."""
    table, target = dh_table(settings.arm.dh), settings.scene.object_of_interest
    start = np.radians(settings.plant.start_pose_deg)
    R_BT = R_WO_FACING_ARM @ exp_so3(np.radians(target.tilt_deg)) @ R_TM_NOMINAL.T
    p_BT = np.array(target.position_m) - settings.vision.programs.positioning.clearance_m * R_BT[:, 2]
    key = "scene.object_of_interest.position_m"
    verdict, q, distance, limit = joint_angles(table, R_BT, p_BT, start)
    if verdict != REACHED:
        why = f"{distance:.2f} m from lift pivot to wrist, the boom's limit is {limit:.2f} m"
        return HealthCheck("object, reach", "failed", why, f"{key}: nearer, or from where the arm can go")
    for joint, at in zip(settings.arm.joints, np.degrees(q), strict=True):
        if not joint.lower_deg <= at <= joint.upper_deg:
            why = f"{joint.name} at {at:.1f}° of {joint.lower_deg:g} to {joint.upper_deg:g}°"
            return HealthCheck("object, reach", "failed", why, key)
    return HealthCheck("object, reach", *_in_workspace(settings, p_BT, key))
