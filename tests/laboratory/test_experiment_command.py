"""One command for every experiment: its options, its verdict with each limit, and under what conditions."""

import json
from pathlib import Path

import pytest

from laboratory.campaigns.experiment import Experiment, at_least, inside
from laboratory.experiments.catalogue import CATALOGUE
from tests.support.commands import ran


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_experiment_has_a_command_with_the_options_of_all(name: str) -> None:
    assert all(isinstance(CATALOGUE[name].load(method), Experiment) for method in CATALOGUE[name].places)
    shown = ran("experiment", name, "--help")
    for option in ("--out", "--fresh", "--scheduler", "--workers", "--config-dir", "--json"):
        assert option in shown.output


def test_each_method_has_its_own_defaults() -> None:
    corrected, programs = (CATALOGUE["positioning"].load(name) for name in ("corrected", "programs"))
    assert (corrected.runs, programs.runs) == (200, 20)


def test_a_verdict_is_met_or_not_by_each_limit_and_says_the_conditions(tmp_path: Path) -> None:
    rows, report = tmp_path / "rows", tmp_path / "report.json"
    command = ["experiment", "hua", "--method", "stress", "--count", "2", "--workers", "0"]
    command += ["--out", str(rows), "--json", str(report)]
    first = ran(*command).output
    assert "seeds 1 to 2; world: drawn scenes; eyes: none: poses with noise; configuration: " in first
    assert "2 rows reused, 0 measured now" in ran(*command).output
    assert "0 rows reused, 2 measured now" in ran(*command, "--fresh").output
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["passed"]
    assert all(check["met"] is not False for check in figures["checks"])
    assert len(figures["rows"]) == 2


def test_a_limit_that_is_missed_is_not_met_and_information_is_neither() -> None:
    assert at_least("share", 0.94, 0.95).met is False
    assert at_least("share", float("nan"), 0.95).met is False
    assert at_least("share", 0.94, None).met is None
    assert inside("variance", 1.3, (0.8, 1.2)).met is False
