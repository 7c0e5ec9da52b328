"""One command for every experiment: its options, its verdict with each limit, and under what conditions."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from laboratory.campaigns.experiment import Experiment, at_least, inside
from laboratory.experiments.catalogue import CATALOGUE
from testbed.cli.main import app


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_experiment_has_a_command_with_the_options_of_all(name: str) -> None:
    assert all(isinstance(CATALOGUE[name].load(method), Experiment) for method in CATALOGUE[name].places)
    shown = CliRunner().invoke(app, ["experiment", name, "--help"], terminal_width=200)
    assert shown.exit_code == 0
    for option in ("--out", "--fresh", "--scheduler", "--workers", "--config-dir", "--json"):
        assert option in shown.output


def test_each_method_has_its_own_defaults_and_takes_its_own_options_alone(tmp_path: Path) -> None:
    corrected, programs = (CATALOGUE["positioning"].load(name) for name in ("corrected", "programs"))
    assert (corrected.runs, programs.runs) == (200, 20)
    words = ["experiment", "positioning", "--looks", "3", "--out", str(tmp_path)]
    refused = CliRunner().invoke(app, [*words, "--method", "corrected"])
    assert refused.exit_code == 2
    assert "--looks is not an option of --method corrected" in refused.stderr


def test_a_verdict_is_met_or_not_by_each_limit_and_says_the_conditions(tmp_path: Path) -> None:
    rows, report = tmp_path / "rows", tmp_path / "report.json"
    command = ["experiment", "hua", "--method", "stress", "--count", "2", "--workers", "0"]
    command += ["--out", str(rows), "--json", str(report)]
    first = CliRunner().invoke(app, command)
    assert "seeds 1 to 2; world: drawn scenes; eyes: none: poses with noise; configuration: " in first.output
    again = CliRunner().invoke(app, command)
    assert "2 rows reused, 0 measured now" in again.output
    assert "0 rows reused, 2 measured now" in CliRunner().invoke(app, [*command, "--fresh"]).output
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["passed"] == all(check["met"] is not False for check in figures["checks"])
    assert first.exit_code == (0 if figures["passed"] else 1)
    assert len(figures["rows"]) == 2


def test_a_limit_that_is_missed_is_not_met_and_information_is_neither() -> None:
    assert at_least("share", 0.94, 0.95).met is False
    assert at_least("share", float("nan"), 0.95).met is False
    assert at_least("share", 0.94, None).met is None
    assert inside("variance", 1.3, (0.8, 1.2)).met is False
