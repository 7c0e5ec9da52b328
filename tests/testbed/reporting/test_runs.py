"""Directories of runs: one for each, with what made it; one without results does not stay."""

import json
from pathlib import Path

import pytest

from testbed.reporting.run_directory import run_directory


def test_two_runs_in_one_second_get_two_directories_that_say_what_made_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["/somewhere/bin/longreach", "demo", "--seed", "3"])
    with run_directory(tmp_path / "runs") as first, run_directory(tmp_path / "runs") as second:
        assert first != second
        made = json.loads((first / "run.json").read_text())
    assert made["command"] == ["longreach", "demo", "--seed", "3"]
    assert made["libraries"]["numpy"]


def test_a_run_directory_without_results_does_not_stay(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    with pytest.raises(KeyboardInterrupt), run_directory(runs):
        raise KeyboardInterrupt
    assert not runs.exists()
    with run_directory(runs) as directory:
        (directory / "report.html").write_text("a result")
    assert directory.is_dir()
