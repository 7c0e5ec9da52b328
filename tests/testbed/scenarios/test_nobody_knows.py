"""Nobody knows the truth: what controller and vision believe of the machine is not the plant's own number."""

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from foundation.configuration import parse_overrides
from plant_emulator.config.actuators import BAR, LITRE_PER_MINUTE
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES, JointName
from testbed.scenarios.arms import arm_names, arm_overrides
from testbed.scenarios.scenario import Settings, load_settings
from tests.support.paths import CONFIGS

Pair = tuple[str, float, float]  # what is believed, the belief, the truth


def free_speeds(plant: PlantConfig, name: JointName) -> tuple[float, float]:
    """A joint's actuator's speeds, out and back, with its valve fully open and no load: m/s or rad/s."""
    actuator = getattr(plant.actuators, name)
    valve = plant.valves.of(name, actuator.rated_flow_l_min)
    area_a, area_b = actuator.areas()
    supply, back = plant.pump.pressure_bar * BAR, plant.pump.return_bar * BAR

    def speed(flow_l_min: float, fed: float, emptied: float) -> float:
        gain = flow_l_min * LITRE_PER_MINUTE / np.sqrt(plant.valves.rated_drop_bar * BAR)
        return float(gain * np.sqrt((fed * supply - emptied * back) / (area_a**3 + area_b**3)))

    return speed(valve.flow_extend_l_min, area_a, area_b), speed(valve.flow_retract_l_min, area_b, area_a)


def of_the_valves(settings: Settings) -> Iterator[Pair]:
    for number, name in enumerate(JOINT_NAMES):
        believed = getattr(settings.controller.valves, name)
        actuator, drive = getattr(settings.plant.actuators, name), settings.arm.drives[number]
        truth = settings.plant.valves.of(name, actuator.rated_flow_l_min)
        for edge in (believed.raising, believed.lowering):
            for deadband in truth.deadband:
                yield f"{name}.deadband", edge.deadband.value, deadband
        yield f"{name}.hysteresis", believed.hysteresis.value, truth.hysteresis
        yield f"{name}.delay_ms", believed.delay_ms.value, truth.delay_ms
        numbers = [v for k, v in drive.model_dump().items() if k.startswith(("extend", "retract")) and v]
        for speed in numbers:
            for true in free_speeds(settings.plant, name):
                yield f"{name}.speed", float(speed), true


def of_the_camera(settings: Settings) -> Iterator[Pair]:
    calibration, camera = settings.vision.camera.calibration, settings.scene.camera
    yield "baseline_m", calibration.baseline_m, camera.baseline_m
    for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
        yield name, getattr(calibration.left, name), getattr(camera.lens, name)


def of_the_backlash(settings: Settings) -> Iterator[Pair]:
    truths = settings.plant.errors.backlash.half_width_mrad
    for believed, true in zip(settings.vision.hand_eye.arm.play_mrad, truths, strict=True):
        yield "play_mrad", believed, true


PARTS = (of_the_valves, of_the_camera, of_the_backlash)


@cache
def settings_of(arm: str) -> Settings:
    return load_settings(CONFIGS, arm_overrides(CONFIGS, arm))


def copied(settings: Settings) -> list[Pair]:
    """Beliefs equal to the truth: to 1e-6, speeds (worked out from several numbers) to 0.3 %."""
    pairs = [pair for part in PARTS for pair in part(settings)]
    assert len(pairs) > 60

    def equal(name: str, belief: float, truth: float) -> bool:
        tolerance = 0.003 if name.endswith("speed") else 1e-6
        return truth != 0.0 and abs(belief - truth) <= tolerance * abs(truth)

    return [pair for pair in pairs if equal(*pair)]


@pytest.mark.parametrize("arm", arm_names(CONFIGS))
def test_no_belief_is_the_plants_own_number(arm: str) -> None:
    assert copied(settings_of(arm)) == []


@pytest.mark.parametrize(
    ("assignment", "found"),
    [
        ("plant.valves.joints.lift.deadband.supply_b=0.005", "lift.deadband"),
        ("plant.errors.backlash.half_width_mrad=[0.3,1,1,1,1,1]", "play_mrad"),
        ("plant.valves.joints.tilt.flow_l_min=100.0", "tilt.speed"),
        ("scene.camera.lens.fx_px=530.0", "fx_px"),
        ("scene.camera.baseline_m=0.12", "baseline_m"),
    ],
)
def test_a_truth_that_was_copied_is_found(assignment: str, found: str) -> None:
    settings = load_settings(CONFIGS, parse_overrides([assignment]))
    assert found in [pair[0] for pair in copied(settings)]
