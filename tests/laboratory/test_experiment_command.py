"""One command for every experiment: its options, its verdict with each limit, and under what conditions."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from laboratory.campaigns.experiment import Experiment, at_least, inside
from laboratory.campaigns.options import PINNED, written_down
from laboratory.command import app as typer_group
from laboratory.command import shown_of
from laboratory.experiments.catalogue import OURS, catalogue
from testbed.cli.main import app


@pytest.mark.parametrize("name", OURS)
def test_every_experiment_has_a_command_with_the_options_of_all(name: str) -> None:
    assert all(isinstance(catalogue()[name].load(method), Experiment) for method in OURS[name].places)
    shown = CliRunner().invoke(app, ["experiment", name, "--help"], terminal_width=200)
    assert shown.exit_code == 0
    for option in ("--out", "--fresh", "--scheduler", "--workers", "--config-dir", "--json"):
        assert option in shown.output


def written(names: Iterable[str]) -> dict[str, Any]:
    return {name: written_down(shown_of(catalogue()[name])) for name in names}


@pytest.mark.parametrize("name", OURS)
def test_help_tells_what_the_experiment_itself_has(name: str) -> None:
    """After a change of options: python -m tests.laboratory.test_experiment_command"""
    (told,) = written([name]).values()
    assert json.loads(PINNED.read_text(encoding="utf-8"))[name] == told
    group = typer.main.get_command(typer_group)
    without = group.resolve_command(typer.Context(group), [name, "--help"])[1]  # type: ignore[attr-defined]
    loaded = group.resolve_command(typer.Context(group), [name])[1]  # type: ignore[attr-defined]
    assert without is not loaded
    assert helped(without) == helped(loaded)


def helped(command: Any) -> list[Any]:
    """What help shows of each option."""
    context = typer.Context(command, info_name=command.name)
    return [option.get_help_record(context) for option in command.get_params(context)]


def test_each_method_has_its_own_defaults_and_takes_its_own_options_alone(tmp_path: Path) -> None:
    corrected, servoing = (catalogue()["positioning"].load(name) for name in ("corrected", "visual-servoing"))
    assert (corrected.runs, servoing.runs) == (200, 60)
    words = ["experiment", "targets", "--only", "plane", "--out", str(tmp_path)]
    refused = CliRunner().invoke(app, [*words, "--method", "hole-drives"])
    assert refused.exit_code == 2
    assert "--only is not an option of --method hole-drives" in refused.stderr


def test_a_verdict_is_met_or_not_by_each_limit_and_says_the_conditions(tmp_path: Path) -> None:
    rows, report = tmp_path / "rows", tmp_path / "report.json"
    command = [
        "experiment",
        "validation",
        "--method",
        "rough",
        "--count",
        "2",
        "--workers",
        "0",
        "--step-ms",
        "0.5",
    ]
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


if __name__ == "__main__":
    PINNED.write_text(json.dumps(written(OURS), indent=1) + "\n", encoding="utf-8")
