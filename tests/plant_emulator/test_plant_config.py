"""Non-physical parameters are refused at load, with key, value, limit and reason."""

from typing import Any

import pytest
import yaml

from plant_emulator.core.mechanics.geometry import build_chain
from tests.plant_emulator.plant_world import CONFIGS, assert_refused, plant_config


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        (
            {"actuators": {"lift": {"dead_volume_a_l": -1.0}}},
            ["actuators.lift.dead_volume_a_l", "-1.0", "0.02"],
        ),
        (
            {"actuators": {"lift": {"cylinder": {"stroke_m": 0.56}}}},
            ["actuators.lift.cylinder.stroke_m", "0.56", "0.55323", "lever vanishes"],
        ),
        (
            {"actuators": {"tilt": {"cylinder": {"length_m": 0.5}}}},
            ["actuators.tilt.cylinder.length_m", "0.5", "0.82317", "would not close"],
        ),
        (
            {"actuators": {"lift": {"cylinder": {"rod_mm": 90.0}}}},
            ["actuators.lift.cylinder.rod_mm", "90.0", "bore_mm = 80", "no area"],
        ),
        (
            {"actuators": {"lift": {"cylinder": {"friction": {"static_n": 100.0}}}}},
            ["static_n", "100.0", "4000", "holds most at rest"],
        ),
        (
            {"actuators": {"slew": {"rotary": {"to_deg": 0.0, "from_deg": 0.0}}}},
            ["rotary.to_deg", "0.0", "greater than 0"],
        ),
        ({"actuators": {"slew": {"rotary": None}}}, ["actuators.slew", "exactly one of cylinder and rotary"]),
        ({"pump": {"pressure_bar": 25.0, "return_bar": 30.0}}, ["return_bar", "30.0", "below pressure_bar"]),
        (
            {"actuators": {"lift": {"cylinder": {"end_stop": {"cushion_m": 0.3}}}}},
            ["actuators.lift.cylinder.end_stop", "cushion_m = 0.3", "0.2725", "would meet"],
        ),
        (
            {"actuators": {"wrist1": {"rotary": {"end_stop": {"cushion_deg": 100.0}}}}},
            ["actuators.wrist1.rotary.end_stop", "cushion_deg = 100", "90", "would meet"],
        ),
        (
            {"masses": {"tool": {"gyration_m": [0.05, 0.05, 0.2]}}},
            ["masses.tool.gyration_m", "0.2", "0.0707", "no body"],
        ),
        (
            {"oil": {"reference_degc": -30.0, "modulus_per_k": 0.009}},
            ["oil.modulus_per_k", "0.009", "0.00571", "110 °C"],
        ),
        (
            {"pump": {"pressure_bar": 240.0}},
            ["pump", "pressure_bar = 240", "protection.relief_bar = 230", "never close"],
        ),
        ({"step_ms": 0.7}, ["step_ms", "0.7", "0.594", "dead_volume", "diverge"]),
        ({"actuators": {"wrist1": {"dead_volume_a_l": 0.1}}}, ["step_ms", "0.119", "wrist1.dead_volume_a_l"]),
        ({"pump": {"droop_bar": 0.1}}, ["step_ms", "pump.droop_bar"]),
        ({"valves": {"bandwidth_hz": float("nan")}}, ["valves.bandwidth_hz", "finite"]),
        ({"valves": {"deadbnad": 0.1}}, ["valves.deadbnad", "did you mean deadband"]),
        ({"errors": {"backlash": {"half_width_mrad": [0.3, -0.1, 0, 0, 0, 0]}}}, ["half_width_mrad", "-0.1"]),
    ],
)
def test_refused_with_key_value_limit_and_reason(changes: dict[str, Any], parts: list[str]) -> None:
    assert_refused(changes, parts)


@pytest.mark.parametrize("name", ["plant.yaml", "arms/long_crane/plant.yaml"])
def test_every_number_has_its_provenance_beside_it(name: str) -> None:
    """Each line with a number, or the line that opens its block, carries one of the marks."""
    text = (CONFIGS / name).read_text(encoding="utf-8")
    assert yaml.safe_load(text)
    marks, open_marks = ("[S]", "[E]", "[M]", "[D]", "[R]"), [(-1, False)]
    for number, line in enumerate(text.splitlines(), 1):
        body, _, comment = line.partition("#")
        if not body.strip():
            continue
        indent = len(body) - len(body.lstrip())
        while open_marks[-1][0] >= indent:
            open_marks.pop()
        marked = any(mark in comment for mark in marks) or open_marks[-1][1]
        value = body.partition(":")[2].strip()
        if not value or (value.startswith("&") and " " not in value):
            open_marks.append((indent, marked))
        elif any(c.isdigit() for c in value or body):
            assert marked, f"{name}:{number}: {line.strip()}"


def test_geometric_errors_displace_a_joint_and_all_behind_it() -> None:
    off = plant_config(errors={"geometry": {"enabled": False}})
    zero = {"offset_mm": [0.0, 0.0, 0.0], "tilt_mrad": [0.0, 0.0, 0.0]}
    clean = dict.fromkeys(("lift", "tilt", "wrist1", "wrist2", "wrist3", "tool"), zero)
    moved = plant_config(
        errors={"geometry": {**clean, "tilt": {"offset_mm": [1.0, 2.0, 3.0], "tilt_mrad": [0, 0, 0]}}}
    )
    before, after = build_chain(off), build_chain(moved)
    shift = after.point - before.point
    assert abs(shift[:4]).max() == 0.0
    assert abs(shift[4:] - [1e-3, 2e-3, 3e-3]).max() < 1e-15
    assert abs(after.X_BT_home[:3, 3] - before.X_BT_home[:3, 3] - [1e-3, 2e-3, 3e-3]).max() < 1e-15
