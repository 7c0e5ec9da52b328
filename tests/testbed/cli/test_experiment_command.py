"""One command for every experiment: its options, its verdict with each limit, and under what conditions."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from testbed.campaigns.experiment import Experiment, at_least, inside
from testbed.cli.main import app
from testbed.experiments.catalogue import catalogue

OLD_COMMANDS = (
    "paper", "table2", "table3", "table4", "fig5", "fig6", "fig7", "fig8", "fig9", "ablation", "sweep",
    "best-mode", "looking-and-moving", "eyes-agree", "eyes-measure", "path-information", "lockstep-demo",
    "hua-fig5", "hua-fig6", "hua-fig7", "hua-intrinsics", "hand-eye-stress", "hand-eye-guided", "stream-cuts",
    "controller-kills", "plant-campaign",
)  # fmt: skip


@pytest.mark.parametrize("name", [*OLD_COMMANDS, "positioning"])
def test_every_experiment_has_a_command_with_the_options_of_all(name: str) -> None:
    assert isinstance(catalogue()[name].load(), Experiment)
    shown = CliRunner().invoke(app, ["experiment", name, "--help"], terminal_width=200)
    assert shown.exit_code == 0
    for option in ("--out", "--fresh", "--scheduler", "--workers", "--config-dir", "--json"):
        assert option in shown.output


def test_the_list_says_what_each_shows_and_costs() -> None:
    listed = CliRunner().invoke(app, ["experiment", "list"])
    assert listed.exit_code == 0
    assert all(name in listed.output for name in catalogue())


def test_positioning_has_both_methods_and_their_own_defaults() -> None:
    corrected, servoing = (catalogue()["positioning"].load(name) for name in ("corrected", "visual-servoing"))
    assert (corrected.name, corrected.runs) == ("best-mode", 200)
    assert (servoing.name, servoing.runs) == ("looking-and-moving", 60)


def test_a_verdict_is_met_or_not_by_each_limit_and_says_the_conditions(tmp_path: Path) -> None:
    rows, report = tmp_path / "rows", tmp_path / "report.json"
    command = ["experiment", "plant-campaign", "--count", "2", "--workers", "0", "--step-ms", "0.5"]
    command += ["--out", str(rows), "--json", str(report)]
    first = CliRunner().invoke(app, command)
    assert "runs that failed" in first.output
    assert (
        "2 runs, seeds 1 to 2; world: the plant alone; eyes: none; step ms: 0.5; 0 rows reused"
        in first.output
    )
    again = CliRunner().invoke(app, command)
    assert "2 rows reused, 0 measured now" in again.output
    assert "0 rows reused, 2 measured now" in CliRunner().invoke(app, [*command, "--fresh"]).output
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert [check["met"] for check in figures["checks"]] == [True, figures["passed"]]
    assert first.exit_code == (0 if figures["passed"] else 1)
    assert len(figures["rows"]) == 2


def test_a_limit_that_is_missed_is_not_met_and_information_is_neither() -> None:
    assert at_least("share", 0.94, 0.95).met is False
    assert at_least("share", float("nan"), 0.95).met is False
    assert at_least("share", 0.94, None).met is None
    assert inside("variance", 1.3, (0.8, 1.2)).met is False
