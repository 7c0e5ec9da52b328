"""Configuration: the shipped files load; what is wrong is named with key, value and limit."""

from typing import Any

import pytest

from controller.config import ControllerConfig
from foundation.configuration import load
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError
from tests.controller.conftest import CONFIGS


def test_shipped_files_load(arm: NominalArm, config: ControllerConfig) -> None:
    assert [joint.name for joint in arm.joints] == ["slew", "lift", "tilt", "wrist1", "wrist2", "wrist3"]
    assert config.cycle_ms == 5.0


@pytest.mark.parametrize(
    ("overrides", "key", "cause"),
    [
        ({"cycle_ms": 0.5}, "cycle_ms", "configuration.greater_than_equal"),
        ({"cycle_ms": 11}, "cycle_ms", "configuration.less_than_equal"),
        ({"cycles_ms": 5}, "cycles_ms", "configuration.unknown_key"),
        ({"motion": {"speed_m_s": -1}}, "motion.speed_m_s", "configuration.greater_than"),
        ({"motion": {"speed_m_s": float("nan")}}, "motion.speed_m_s", "configuration.finite_number"),
        ({"joint_control": {"gain_1_s": [1, 2, 3]}}, "joint_control.gain_1_s", "configuration.missing"),
        ({"pose_servo": {"dead_zone_mrad": 0.4}}, "settled.tolerance_mrad", "configuration.value_error"),
        ({"streaming": {"silence_ms": 30.0}}, "streaming.silence_ms", "configuration.value_error"),
        ({"cycle_ms": 10, "streaming": {"silence_ms": 53.0}}, "silence_ms", "configuration.value_error"),
        ({"streaming": {"jerk_m_s3": 0.0}}, "streaming.jerk_m_s3", "configuration.greater_than"),
        ({"plant_link": {"port": 70000}}, "plant_link.port", "configuration.less_than_equal"),
    ],
)
def test_bad_controller_values_are_named(overrides: dict[str, Any], key: str, cause: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load(ControllerConfig, CONFIGS / "controller.yaml", overrides)
    assert caught.value.cause == cause
    assert key in str(caught.value)
    assert "\n" not in str(caught.value)


def _rows(**changes: Any) -> list[dict[str, Any]]:
    arm = load(NominalArm, CONFIGS / "arm.yaml").model_dump(mode="json")
    for where, value in changes.items():
        index, field = where.split("__")
        arm["dh"][int(index[1:])][field] = value
    return list(arm["dh"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"r1__alpha_deg": 90.0}, "Table 1 has 0"),
        ({"r4__a_m": 0.1}, "dh wrist2: a_m"),
        ({"r2__d_m": 0.1}, "dh tilt: d_m"),
        ({"r6__theta_offset_deg": 5.0}, "dh mock: theta_offset_deg"),
    ],
)
def test_an_arm_of_another_structure_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        load(NominalArm, CONFIGS / "arm.yaml", {"dh": _rows(**change)})
