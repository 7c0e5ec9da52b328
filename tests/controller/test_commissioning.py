"""A commissioning file on the controller's side: what it changes, and what of it is refused by name."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from controller.commissioning import basis_of
from controller.config import ControllerConfig
from controller.core.settings import settings_from
from foundation.configuration import load, merged
from nominal_arm.commissioned import Commissioned, MeasuredNumber, ValveEdge, found_numbers
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError
from tests.support.paths import CONFIGS


@pytest.fixture
def found(arm: NominalArm, config: ControllerConfig) -> dict[str, Any]:
    """The content of a file that commissioning might have written for the shipped configuration."""
    valves = config.valves.model_dump(mode="json")
    lift = valves["lift"]
    lift["raising"]["deadband"] = {"value": 0.061, "std": 0.002, "bounds": [0.0, 0.2], "recording": "r1"}
    lift["lowering"]["deadband"] = {"value": 0.083, "std": 0.003, "bounds": [0.0, 0.2]}
    lift["lowering"]["flow_gain"] = {"value": 0.8, "std": 0.02}
    lift["hysteresis"] = {"value": 0.02, "std": 0.004}
    basis = basis_of(arm, config).model_dump()
    return {
        "made_utc": "2026-11-22T10:00:00Z",
        "made_by": "longreach commission",
        "basis": basis,
        "valves": valves,
        "tuning": {"gain_1_s": [2.0, 3.0, 4.0, 10.0, 10.0, 10.0]},
    }


def _with(config: ControllerConfig, found: dict[str, Any]) -> ControllerConfig:
    return config.model_copy(update={"commissioned": Commissioned.model_validate(found)})


def test_what_was_found_takes_the_place_of_what_was_believed(
    arm: NominalArm, config: ControllerConfig, found: dict[str, Any]
) -> None:
    before, after = settings_from(arm, config), settings_from(arm, _with(config, found))
    assert after.servo.joints.deadband[1].tolist() == [0.061, 0.083]
    assert after.servo.joints.flow_gain[1].tolist() == [1.0, 0.8]
    assert after.servo.joints.gain.tolist() == [2.0, 3.0, 4.0, 10.0, 10.0, 10.0]
    assert after.servo.joints.time_constant.tolist() == before.servo.joints.time_constant.tolist()
    others = [0, 2, 3, 4, 5]
    assert after.servo.joints.deadband[others].tolist() == before.servo.joints.deadband[others].tolist()


def test_an_encoder_counts_as_stuck_beyond_what_is_known_of_its_valve(
    arm: NominalArm, config: ControllerConfig, found: dict[str, Any]
) -> None:
    limits = settings_from(arm, _with(config, found)).supervision.encoder_stuck_valves
    assert limits[1] == pytest.approx([0.061 + 0.006 + 0.02 + 0.012, 0.083 + 0.009 + 0.02 + 0.012])
    assert settings_from(arm, config).supervision.encoder_stuck_valves == pytest.approx(np.full((6, 2), 0.02))


def test_a_path_is_read_from_beside_the_file_that_names_it(
    tmp_path: Path, config: ControllerConfig, found: dict[str, Any]
) -> None:
    whole = config.model_dump(mode="json") | {"commissioned": "found.yaml"}
    (tmp_path / "controller.yaml").write_text(yaml.safe_dump(whole))
    (tmp_path / "found.yaml").write_text(yaml.safe_dump(found))
    read = load(ControllerConfig, tmp_path / "controller.yaml").commissioned
    assert read is not None
    assert read.valves.lift.raising.deadband.value == 0.061


def test_a_fault_in_the_named_file_is_told_with_that_file(
    tmp_path: Path, config: ControllerConfig, found: dict[str, Any]
) -> None:
    found["valves"]["tilt"]["hysteresis"]["std"] = -1.0
    (tmp_path / "found.yaml").write_text(yaml.safe_dump(found))
    path = CONFIGS / "controller.yaml"
    with pytest.raises(ConfigurationError, match=r"found\.yaml: valves\.tilt\.hysteresis\.std") as caught:
        load(ControllerConfig, path, {"commissioned": str(tmp_path / "found.yaml")})
    assert caught.value.cause == "configuration.greater_than_equal"
    with pytest.raises(ConfigurationError, match=r"none\.yaml") as missing:
        load(ControllerConfig, path, {"commissioned": str(tmp_path / "none.yaml")})
    assert missing.value.cause == "configuration.unreadable"


@pytest.mark.parametrize(
    ("changes", "cause", "words"),
    [
        ({"basis": {"arm": "another"}}, "commissioned.other_arm", "'another'"),
        ({"basis": {"arm_hash": "0" * 16}}, "commissioned.stale", "arm_hash"),
        ({"basis": {"controller_hash": "0" * 16}}, "commissioned.stale", "controller_hash"),
        ({"valves": {"name": "mobile"}}, "commissioned.other_valves", "'mobile'"),
        (
            {"valves": {"lift": {"raising": {"deadband": {"value": 0.19999}}}}},
            "commissioned.at_bound",
            "valves.lift.raising.deadband = 0.19999 sits at its bound 0.2",
        ),
        (
            {"tuning": {"gain_1_s": [2.0, 3.0, 4.0, 10.0, 10.0, 60.0]}},
            "configuration.less_than_equal",
            "less than or equal to 50",
        ),
    ],
)
def test_what_cannot_be_trusted_is_refused_by_name(
    arm: NominalArm,
    config: ControllerConfig,
    found: dict[str, Any],
    changes: dict[str, Any],
    cause: str,
    words: str,
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        settings_from(arm, _with(config, merged(found, changes)))
    assert caught.value.cause == cause
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "changed",
    [
        {"cycle_ms": 4.0},
        {"valves": {"slew": {"lag_ms": {"value": 9.0}}}},
        {"joint_control": {"valve_limit": 0.7}},
    ],
)
def test_a_change_of_what_it_rests_on_makes_it_stale(
    arm: NominalArm, config: ControllerConfig, found: dict[str, Any], changed: dict[str, Any]
) -> None:
    later = load(ControllerConfig, CONFIGS / "controller.yaml", changed)
    with pytest.raises(ConfigurationError) as caught:
        settings_from(arm, _with(later, found))
    assert caught.value.cause == "commissioned.stale"


def test_a_change_of_anything_else_does_not(
    arm: NominalArm, config: ControllerConfig, found: dict[str, Any]
) -> None:
    later = load(ControllerConfig, CONFIGS / "controller.yaml", {"motion": {"speed_m_s": 0.2}})
    settings_from(arm, _with(later, found))


@pytest.mark.parametrize(
    ("value", "bounds", "reached"),
    [
        (0.1, (0.0, 0.2), None),
        (0.0001, (0.0, 0.2), 0.0),
        (0.1999, (0.0, 0.2), 0.2),
        (0.0, (None, 0.2), None),
        (5.0, (None, None), None),
        (0.2, (None, 0.2), 0.2),
    ],
)
def test_a_number_sits_at_a_bound_within_a_thousandth_of_the_way(
    value: float, bounds: tuple[float | None, float | None], reached: float | None
) -> None:
    assert MeasuredNumber(value=value, std=0.01, bounds=bounds).bound_reached() == reached


@pytest.mark.parametrize("curve", [[(0.1, 0.2), (0.1, 0.3)], [(0.1, 0.2), (0.2, 0.2)], [(0.0, 0.1)]])
def test_a_flow_curve_rises(curve: list[tuple[float, float]]) -> None:
    number = {"value": 1.0, "std": 0.0}
    with pytest.raises(ValueError, match="does not rise in both"):
        ValveEdge.model_validate({"deadband": number | {"value": 0.1}, "flow_gain": number, "curve": curve})


def test_every_number_is_found_by_name(found: dict[str, Any]) -> None:
    names = [name for name, _ in found_numbers(Commissioned.model_validate(found))]
    assert len(names) == 6 * 8
    assert names[0] == "valves.slew.raising.deadband"
