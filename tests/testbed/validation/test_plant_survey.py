"""The survey of positioning errors, held against figures stated for this class of arm and against statics."""

import json
import math
from pathlib import Path

import pytest

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from testbed.validation import plant_survey, plant_survey_report
from testbed.validation.plant_survey import ARMS, STATED_SAG_MM, SurveyedArm, survey
from testbed.validation.plant_survey_report import run_survey
from tests.plant_emulator.plant_world import CONFIGS

DEFAULT, CRANE = ARMS


def test_errors_of_the_default_arm_have_the_stated_size() -> None:
    (row,) = survey(CONFIGS, DEFAULT, lifts_deg=(15,), tilts_deg=(-50,))
    assert row.reach_m == pytest.approx(4.2, abs=0.1)
    sags = dict(zip(DEFAULT.loads_kg, row.sag_mm, strict=True))
    assert list(row.sag_mm) == sorted(row.sag_mm)
    assert sags[130.0] == pytest.approx(STATED_SAG_MM[130.0], rel=0.25)
    assert sags[230.0] == pytest.approx(STATED_SAG_MM[230.0], rel=0.25)
    assert row.play_mm == pytest.approx(0.27 * row.reach_m)  # the slew's, of plant.yaml
    assert 8.0 < row.believed_mm < 40.0
    raw, compensated = row.servo_mm
    assert raw > 10.0 * compensated
    assert 1.5 < row.lowest_hz < 4.0
    assert 0.005 < row.damping < 0.1


@pytest.fixture
def short_servo(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests that do not look at where the servo rests."""
    monkeypatch.setattr(plant_survey, "SERVO_S", 0.1)


@pytest.mark.usefixtures("short_servo")
def test_sag_grows_as_two_hinges_say() -> None:
    """100 kg more at the tool turn both hinges by their moments, K = 4 EI / 3 L; the pose level, lift 0."""
    (row,) = survey(CONFIGS, DEFAULT, lifts_deg=(0,), tilts_deg=(-50,))
    config = load(PlantConfig, CONFIGS / "plant.yaml")
    force, geometry, flexible = 100.0 * config.gravity_m_s2, config.geometry, config.flexibility
    expected = 0.0
    for beam, pivot in ((flexible.boom, geometry.lift_pivot_m[0]), (flexible.arm, None)):
        stiffness = 4.0 * beam.vertical_ei_n_m2 / (3.0 * beam.length_m)
        hinge = beam.length_m / 3.0
        if pivot is not None:
            start, slope = pivot + hinge, 0.0
        else:
            slope = math.radians(-50.0)
            start = geometry.lift_pivot_m[0] + geometry.tilt_pivot_m[0] + hinge * math.cos(slope)
        lever = row.reach_m - start
        expected += force * lever * lever / stiffness  # the vertical part of the tool's way
    grown = row.sag_mm[3] - row.sag_mm[2]
    assert expected <= 1e-3 * grown * 1.05  # the whole way is longer than its vertical part
    assert expected == pytest.approx(1e-3 * grown, rel=0.35)


@pytest.mark.usefixtures("short_servo")
def test_poses_out_of_reach_are_left_out_and_the_crane_is_softer() -> None:
    near, far = survey(CONFIGS, DEFAULT, (15,), (-60,)), survey(CONFIGS, CRANE, (15, 120), (-60,))
    assert len(far) == 1  # the crane's lift does not reach 120°
    assert far[0].sag_mm[0] > 4.0 * near[0].sag_mm[1]
    assert far[0].lowest_hz < 0.7 * near[0].lowest_hz


@pytest.mark.usefixtures("short_servo")
def test_the_command_prints_plots_and_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = tuple(SurveyedArm(arm.name, arm.file, arm.loads_kg, (15,), (-50,)) for arm in ARMS)
    monkeypatch.setattr(plant_survey_report, "ARMS", few)
    rows = run_survey(CONFIGS, tmp_path, tmp_path / "survey.json")
    assert [row.arm for row in rows] == [arm.name for arm in ARMS]
    assert (tmp_path / "plant_survey.png").stat().st_size > 20_000
    figures = json.loads((tmp_path / "survey.json").read_text(encoding="utf-8"))
    assert len(figures["rows"]) == 2
    assert figures["stated"][0][1] == "13"
