"""Files that are spoiled, and the good ones they were made of."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from testbed.cli.main import app
from testbed.experiments.hand_eye.bad_files import BAD_FILES, BadFile, answer, good_file


@pytest.mark.parametrize("bad", BAD_FILES, ids=lambda bad: bad.name)
def test_a_bad_file_is_answered_rightly(bad: BadFile, tmp_path: Path) -> None:
    given = answer(bad, good_file(8, 1), tmp_path)
    assert given.right, given


def test_the_good_file_they_are_made_of_is_good(tmp_path: Path) -> None:
    file = tmp_path / "samples.json"
    file.write_text(json.dumps(good_file(8, 1)), encoding="utf-8")
    result = CliRunner().invoke(app, ["hand-eye", "solve", str(file), "--json", str(tmp_path / "x.json")])
    assert result.exit_code == 0, result.output
    assert "verdict: good" in result.output
    verdict = json.loads((tmp_path / "x.json").read_text())["verdict"]
    assert verdict["word"] == "good"
    assert verdict["scale"]["factor"] == pytest.approx(1.0, abs=5.0 * verdict["scale"]["std"])
    assert verdict["next_best_noise_ratio"] > 5.0


def test_a_refused_file_gives_its_number_only_as_given(tmp_path: Path) -> None:
    good = good_file(8, 1)
    good["setup"] = "eye-to-hand"
    file = tmp_path / "samples.json"
    file.write_text(json.dumps(good), encoding="utf-8")
    refused = CliRunner().invoke(app, ["hand-eye", "solve", str(file)])
    assert refused.exit_code != 0
    assert "residuals" not in refused.output
    told = CliRunner().invoke(app, ["hand-eye", "solve", str(file), "--as-given"])
    assert told.exit_code == 0, told.output
    assert "verdict: refused" in told.output
    assert "residuals" in told.output


def test_a_questioned_file_gives_its_number_and_status_1(tmp_path: Path) -> None:
    """Camera lengths 3 % too long: a target measured a little wrongly."""
    good = good_file(40, 1)
    for sample in good["samples"]:
        for row in sample["camera"][:3]:
            row[3] *= 1.03
    file = tmp_path / "samples.json"
    file.write_text(json.dumps(good), encoding="utf-8")
    said = CliRunner().invoke(app, ["hand-eye", "solve", str(file)])
    assert "verdict: questioned" in said.output
    assert "residuals" in said.output
    assert said.exit_code == 1
    assert CliRunner().invoke(app, ["hand-eye", "solve", str(file), "--as-given"]).exit_code == 0
