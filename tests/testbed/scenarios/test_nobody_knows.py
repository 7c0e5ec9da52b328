"""Nobody knows the truth: no number that controller or vision believes is the plant's own by construction.

Every number of arm, controller and vision is set against every hidden number of plant and scene in the same
unit: of every arm, with either set of valves, and of vision that adapts. Two may be equal only where the
truth can be measured (a drawing, a gauge, a ruler), where the number is a choice and no belief, or where
they are of different things: each with its reason.
"""

import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pytest

from foundation.configuration import parse_overrides, read_yaml
from plant_emulator.config.actuators import BAR, LITRE_PER_MINUTE
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES, JointName
from testbed.scenarios.arms import arm_names, arm_overrides
from testbed.scenarios.scenario import Settings, load_settings
from tests.support.paths import CONFIGS

MEASURABLE = {
    "plant.geometry.*": "the drawing; what is wrong with it is errors.geometry",
    "plant.masses.*": "the drawing, or a scale",
    "plant.actuators.*.cylinder.base_m": "the drawing",
    "plant.actuators.*.cylinder.lever_m": "the drawing",
    "plant.actuators.*.cylinder.angle_rad": "the drawing",
    "plant.actuators.*.cylinder.length_m": "the drawing",
    "plant.actuators.*.cylinder.stroke_m": "the drawing, or a ruler",
    "plant.actuators.*.cylinder.bore_mm": "the name plate",
    "plant.actuators.*.cylinder.rod_mm": "the name plate, or a caliper",
    "plant.actuators.*.rotary.from_deg": "the drawing",
    "plant.actuators.*.rotary.to_deg": "the drawing",
    "plant.actuators.*.cushion_*": "the drawing",
    "plant.actuators.*.dead_volume_*": "the drawing",
    "plant.flexibility.*.length_m": "the drawing",
    "plant.pump.pressure_bar": "a gauge",
    "plant.pump.return_bar": "a gauge",
    "plant.protection.*": "set by hand, on a gauge",
    "plant.pump.*": "the name plate",
    "plant.watchdog_ms": "the coupler's manual",
    "plant.step_ms": "no part of a machine: the integrator's",
    "plant.start_pose_deg*": "a task, not a machine: told by the encoders",
    "plant.payload.*": "a task: weighed; best-mode draws it and tells nobody",
    "scene.seed": "no part of a machine",
    "scene.lighting.*": "the light, of which vision believes nothing",
    "scene.camera.response_gamma": "of grey levels, of which vision believes nothing",
    "scene.wall.*": "the world, of which vision believes nothing",
    "scene.object_of_interest.position_m*": "the task; vision is not told",
    "scene.object_of_interest.tilt_deg*": "the task; vision is not told",
    "scene.object_of_interest.markers*.centre_m": "the drawing; what is wrong with it is misplaced_m",
    "scene.object_of_interest.markers*.marker_id": "printed on it",
    "scene.object_of_interest.markers*.side_m": "as ordered; what is wrong with it is print_scale_error",
    "scene.object_of_interest.markers*.quiet_zone_m": "as ordered",
    "scene.tool_marker.side_m": "as ordered; what is wrong with it is print_scale_error",
    "scene.tool_marker.quiet_zone_m": "as ordered",
    "scene.tool_marker.bracket_*": "a ruler",
    "scene.camera.width_px": "counted",
    "scene.camera.height_px": "counted",
    "scene.camera.rate_hz": "counted",
    "scene.camera.exposure_us": "told in the stream's header",
    "scene.camera.motion_blur_samples": "no part of a camera: the renderer's",
    "scene.camera.exposure_gain": "seen in the picture",
    "scene.camera.shutter.*": "the maker's manual",
}
"""Truth that a user may know to the last digit: pattern of its key → how."""

CHOICES = {
    "arm.workspace.*": "where the tool may go",
    "arm.joints*": "limits that the controller keeps",
    "arm.dh*.alpha_deg": "the table's form",
    "arm.dh*.theta_offset_deg": "the table's form",
    "controller.motion.*": "limits",
    "controller.streaming.*": "limits",
    "controller.settled.*": "what is wanted",
    "controller.supervision.*": "limits",
    "controller.plant_link.*": "of the link",
    "controller.reference_link.*": "of the link",
    "controller.scan_lead": "of the scan",
    "controller.cycle_ms": "of the scan",
    "controller.flight_recorder_scans": "of the recorder",
    "controller.fifo_priority": "of the process",
    "controller.joint_control.feed_forward": "the share of what arm.yaml believes",
    "controller.joint_control.valve_limit": "a limit",
    "controller.pose_servo.damping_*": "of the inverse near a singular pose",
    "vision.camera.stream.*": "of the link",
    "vision.camera.uvc.*": "another camera's",
    "vision.camera.genicam.*": "another camera's",
    "vision.camera.directory.*": "of a recording",
    "vision.odometry_feed.*": "of the link, and limits of another's poses",
    "vision.camera.frozen_frames": "a limit",
    "vision.camera.stale_ms": "a limit",
    "vision.markers.*.id": "printed on it",
    "vision.markers.object*.id": "printed on it",
    "vision.markers.tool.carried_m*": "a ruler, with a rim",
    "vision.look.*": "a choice",
    "vision.odometry.*": "choices, and limits in pixels",
    "vision.link.*": "of the link",
    "vision.motion.*": "limits",
    "vision.api.*": "of the service",
    "vision.programs.orientation.*": "the paper's form",
    "vision.programs.line_equation.*": "the paper's form",
    "vision.programs.trajectory.*": "the paper's form, and limits",
    "vision.programs.positioning.*_m": "what is wanted, and limits",
    "vision.programs.positioning.inputs": "the paper's form",
    "vision.programs.positioning.corrections": "a choice",
    "vision.programs.looking_and_moving.*": "choices and limits of a loop",
    "vision.programs.local_map.leg_m": "a choice",
    "vision.programs.local_map.at_rest.pictures": "a choice",
    "vision.programs.local_map.*_limit_m": "a limit",
    "vision.programs.local_map.near_m": "a limit",
    "vision.hand_eye.marker_*": "another marker's, printed on it",
    "vision.hand_eye.frames": "a choice",
    "vision.hand_eye.minimum_frames": "a choice",
    "vision.hand_eye.distance_m*": "a choice",
    "vision.hand_eye.reach_m": "a choice",
    "vision.hand_eye.clearance_m": "a choice",
    "vision.hand_eye.candidates": "a choice",
    "vision.hand_eye.moved_mrad": "a limit",
    "vision.hand_eye.arm.fit_*": "a limit",
    "vision.cabinet.*": "another picture's",
}
"""Numbers that are no belief about a machine: pattern of their key → what they are."""

COINCIDENCES = {
    ("controller.valves.*.flow_gain.value", "plant.valves.*.slope_*"): "a speed's share, and a curve's shape",
    ("controller.valves.*.deadband.value", "plant.oil.air_fraction"): "of spool, and of oil",
    ("controller.valves.*.delay_ms.std", "plant.valves.*.delay_ms"): "a spread, and a size",
    ("vision.recorded_odometry.d*_px", "scene.camera.rectification.vertical_px"): "depth noise, and rows",
    (
        "vision.recorded_odometry.disparity_std_px",
        "scene.camera.rectification.disparity_px",
    ): "a spread, one eye",
    ("controller.parking.*_mm", "scene.object_of_interest.*.misplaced_m*"): "a tool at rest, and a print",
    ("vision.targets.carried_std_m", "scene.object_of_interest.*.misplaced_m*"): "a drive's, and a print's",
    ("controller.valves.*.flow_gain.std", "plant.valves.*.deadband*"): "of a speed, and of spool",
    ("controller.valves.*.full_stroke_ms.value", "plant.valves.*.delay_ms"): "a spool's way, and its drive",
    ("vision.programs.local_map.rotation_std", "plant.valves.*.hysteresis"): "of a turn, and of spool",
    (
        "vision.markers.calibration.focal_difference_px",
        "scene.camera.rectification.vertical_px",
    ): "a spread of focal lengths, and rows",
    ("vision.markers.calibration.exposed_s", "plant.valves.*.delay_ms"): "a choice of pictures, and a drive",
}
"""Pairs of different things that happen to be equal: patterns of both keys → what they are."""

_EQUAL = 1e-6  # relative, of numbers written down
_DERIVED = 0.003  # relative, of numbers worked out from several: closer, one is the other, rounded
_UNITS = {
    "_mrad_s_bar": "mrad/s/bar", "_m3_s_pa": "m³/s/Pa", "_per_k": "1/K", "_m_s2": "m/s²", "_m_s3": "m/s³",
    "_deg_s2": "deg/s²", "_deg_s3": "deg/s³", "_rad_s": "rad/s", "_m_s": "m/s", "_l_min": "l/min",
    "_n_s_m": "N s/m", "_n_m": "N/m", "_n_m2": "N m²", "_nm_s_rad": "N m s/rad", "_nm_rad": "N m/rad",
    "_n": "N", "_nm": "N m", "_px": "px", "_bar": "bar", "_hz": "Hz", "_kg": "kg", "_grey": "grey",
    "_degc": "°C", "_per_s": "1/s", "_rad": "rad", "_s": "s", "_m": "m", "_l": "l",
}  # fmt: skip
_SCALED = {
    "_mm": ("m", 1e-3), "_mrad": ("rad", 1e-3), "_deg": ("rad", np.pi / 180.0), "_ms": ("s", 1e-3),
    "_us": ("s", 1e-6),
}  # fmt: skip


class Known(NamedTuple):
    """A number in SI units: its key, with the file's stem first, its unit and its size."""

    key: str
    unit: str
    size: float


def numbers(data: Any, key: str) -> Iterator[Known]:
    """Every number below ``key`` that is not zero and not switched off, without its sign."""
    if isinstance(data, dict):
        if data.get("enabled") is False:
            return
        for name, below in data.items():
            yield from numbers(below, f"{key}.{name}")
    elif isinstance(data, list | tuple):
        for index, below in enumerate(data):
            yield from numbers(below, f"{key}[{index}]")
    elif isinstance(data, int | float) and not isinstance(data, bool) and data:
        unit, scale = unit_of(key)
        yield Known(key, unit, abs(scale * data))


def unit_of(key: str) -> tuple[str, float]:
    """The unit that a key's last words name, and what one of its units is in it; "" without any."""
    for part in reversed(re.sub(r"\[\d+\]", "", key).split(".")):
        for suffix in sorted({*_UNITS, *_SCALED}, key=len, reverse=True):
            if f"_{part}".endswith(suffix):
                return _SCALED.get(suffix) or (_UNITS[suffix], 1.0)
        if part not in ("value", "std"):
            break
    return "", 1.0


def matches(key: str, patterns: dict[str, str]) -> bool:
    plain = re.sub(r"\[\d+\]", "", key)
    return any(fnmatchcase(plain, pattern.replace("[", "[[]")) for pattern in patterns)


def all_believed(settings: Settings) -> list[Known]:
    """Every number of arm, controller and vision."""
    return [
        known
        for name in ("arm", "controller", "vision")
        for known in numbers(getattr(settings, name).model_dump(mode="json"), name)
    ]


def all_hidden(settings: Settings) -> list[Known]:
    """Every number of plant and scene, valves as they are in force, and what follows from several."""
    plant = settings.plant.model_dump(mode="json")
    del plant["valves"], plant["valve_set"], plant["valve_sets"]
    found = [*numbers(plant, "plant"), *numbers(settings.scene.model_dump(mode="json"), "scene")]
    for name in JOINT_NAMES:
        actuator = getattr(settings.plant.actuators, name)
        valve = settings.plant.valves.of(name, actuator.rated_flow_l_min)
        found += list(numbers(valve._asdict(), f"plant.valves.{name}"))
        found += speeds(settings.plant, name)
    return found


def of_believed(settings: Settings) -> list[Known]:
    """What arm, controller and vision believe."""
    return [known for known in all_believed(settings) if not matches(known.key, CHOICES)]


def of_hidden(settings: Settings) -> list[Known]:
    """What the plant alone knows."""
    return [known for known in all_hidden(settings) if not matches(known.key, MEASURABLE)]


MOBILE = {"plant": {"valve_set": "mobile"}, "controller": {"valves": {"name": "mobile"}}}
WORLDS = [*arm_names(CONFIGS), "mobile", "adapting"]


@cache
def settings_of(world: str) -> Settings:
    """Of an arm as it ships; of the default arm with mobile valves, or with vision that adapts."""
    if world == "mobile":
        return load_settings(CONFIGS, MOBILE)
    if world == "adapting":
        return load_settings(CONFIGS, {"vision": read_yaml(CONFIGS / "vision_adapting.yaml")})
    return load_settings(CONFIGS, arm_overrides(CONFIGS, world))


def speeds(plant: PlantConfig, name: JointName) -> list[Known]:
    """A joint's actuator's free speeds, out and back, with its valve fully open and no load."""
    actuator = getattr(plant.actuators, name)
    valve = plant.valves.of(name, actuator.rated_flow_l_min)
    area_a, area_b = actuator.areas()
    supply, back = plant.pump.pressure_bar * BAR, plant.pump.return_bar * BAR
    unit = "m/s" if actuator.cylinder is not None else "rad/s"
    found = []
    for way, flow, fed, left in (
        ("extend", valve.flow_extend_l_min, area_a, area_b),
        ("retract", valve.flow_retract_l_min, area_b, area_a),
    ):
        gain = flow * LITRE_PER_MINUTE / np.sqrt(plant.valves.rated_drop_bar * BAR)
        speed = gain * np.sqrt((fed * supply - left * back) / (area_a**3 + area_b**3))
        found.append(Known(f"plant.derived.{name}.{way}_speed", unit, float(speed)))
    return found


def coincide(belief: Known, truth: Known) -> bool:
    return any(
        matches(belief.key, {one: ""}) and matches(truth.key, {other: ""}) for one, other in COINCIDENCES
    )


def tolerance(truth: Known) -> float:
    """How near (relative) is equal."""
    return _DERIVED if ".derived." in truth.key else _EQUAL


def equalities(believed: list[Known], hidden: list[Known]) -> list[str]:
    """Pairs in one unit that are equal, and that nothing excuses."""
    return [
        f"{belief.key} = {truth.key} = {truth.size:g} {truth.unit}"
        for belief in believed
        for truth in hidden
        if belief.unit == truth.unit
        and abs(belief.size - truth.size) <= tolerance(truth) * truth.size
        and not coincide(belief, truth)
    ]


@pytest.mark.parametrize("world", WORLDS)
def test_no_belief_is_the_plants_own_number(world: str) -> None:
    assert equalities(of_believed(settings_of(world)), of_hidden(settings_of(world))) == []


@pytest.mark.parametrize(
    ("assignment", "found"),
    [
        ("plant.valves.joints.lift.deadband.supply_b=0.005", "controller.valves.lift.raising.deadband.value"),
        ("plant.errors.backlash.half_width_mrad=[0.3,1,1,1,1,1]", "vision.hand_eye.arm.play_mrad[0]"),
        ("plant.valves.joints.tilt.flow_l_min=100.0", "arm.drives[2].extend_m_s"),
        ("scene.camera.lens.fx_px=530.0", "vision.camera.calibration.left.fx_px"),
        ("scene.camera.baseline_m=0.12", "vision.camera.calibration.baseline_m"),
        ("vision.markers.print_size_std=0.0006", "vision.markers.print_size_std"),
    ],
)
def test_a_truth_that_was_copied_is_found(assignment: str, found: str) -> None:
    settings = load_settings(CONFIGS, parse_overrides([assignment]))
    assert found in " ".join(equalities(of_believed(settings), of_hidden(settings)))


@pytest.mark.parametrize("patterns", [MEASURABLE, CHOICES], ids=["measurable", "choices"])
def test_every_excuse_is_needed_and_has_a_reason(patterns: dict[str, str]) -> None:
    both = [all_believed(settings_of(world)) + all_hidden(settings_of(world)) for world in WORLDS]
    keys = [known.key for found in both for known in found]
    for pattern, reason in patterns.items():
        assert any(matches(key, {pattern: reason}) for key in keys), f"{pattern} is of nothing"
        assert len(reason) > 5


@pytest.mark.slow("every file of the house is read")
def test_every_coincidence_is_still_one() -> None:
    worlds = [settings_of(world) for world in WORLDS]
    pairs = [pair for world in worlds for pair in product(of_believed(world), of_hidden(world))]
    for one, other in COINCIDENCES:
        assert any(
            belief.unit == truth.unit and abs(belief.size - truth.size) <= tolerance(truth) * truth.size
            for belief, truth in pairs
            if matches(belief.key, {one: ""}) and matches(truth.key, {other: ""})
        ), f"{one} and {other} are not equal any more: strike them out"
