"""The survey of positioning errors, held against the figures stated for this class of arm."""

from pathlib import Path

import pytest

from testbed.validation.plant_survey import STATED_SAG_MM, plot_survey, survey
from tests.plant_emulator.plant_world import CONFIGS


def test_errors_have_the_stated_size(tmp_path: Path) -> None:
    rows = survey(CONFIGS, lifts_deg=(15, 45), tilts_deg=(-50, -90))
    assert len(rows) == 4
    far = rows[0]
    assert far.reach_m == pytest.approx(4.2, abs=0.1)
    assert far.sag_mm[1] == pytest.approx(STATED_SAG_MM[130.0], rel=0.25)
    assert far.sag_mm[2] == pytest.approx(STATED_SAG_MM[230.0], rel=0.25)
    for row in rows:
        assert row.sag_mm[0] < row.sag_mm[1] < row.sag_mm[2]
        assert row.play_mm == pytest.approx(0.6 * row.reach_m)
        assert 8.0 < row.static_error_mm < 40.0
        assert 1.5 < row.lowest_hz < 4.0
        assert 0.0 < row.lowest_damping < 0.1
    plot_survey(rows, tmp_path / "survey.png")
    assert (tmp_path / "survey.png").stat().st_size > 20_000
