"""Directories of runs and their records: what made each, how it ended, and the command that shows them."""

import json
import os
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from protocol.errors import ConfigurationError, LinkLost
from testbed.cli.runs import app
from testbed.reporting import run_record as record
from testbed.reporting.run_directory import all_runs, one_run, run_directory
from testbed.scenarios.scenario import Settings, load_settings
from tests.support.paths import CONFIGS


def made(runs: Path, name: str, **facts: Any) -> Path:
    """A run that has ended, with a file of a kilobyte."""
    directory = runs / name
    directory.mkdir(parents=True)
    (directory / "report.html").write_text("x" * 1000)
    given = {"command": ["longreach", "demo"], "took_s": 12.0, "ended_by": "", **facts}
    (directory / record.RECORD_FILE).write_text(json.dumps(given))
    return directory


def asked(*arguments: str) -> tuple[int, str]:
    """Exit status and output of ``longreach runs``."""
    done = CliRunner().invoke(app, list(arguments), env={"COLUMNS": "200"})
    return done.exit_code, done.output + str(done.exception or "")


def test_two_runs_in_one_second_get_two_directories(tmp_path: Path) -> None:
    with run_directory(tmp_path / "runs") as first, run_directory(tmp_path / "runs") as second:
        assert first != second


def test_a_run_directory_without_results_does_not_stay(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    with pytest.raises(KeyboardInterrupt), run_directory(runs):
        raise KeyboardInterrupt
    assert not runs.exists()
    with run_directory(runs) as directory:
        (directory / "report.html").write_text("kept")
    assert directory.is_dir()


def test_a_run_directory_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no directory")
    with pytest.raises(ConfigurationError) as refused, run_directory(tmp_path / "file"):
        pass
    assert refused.value.cause == "output.unwritable"


def test_a_record_says_what_made_the_run_and_how_it_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["/somewhere/bin/longreach", "demo", "--seed", "3"])

    def fail(directory: Path) -> None:
        (directory / "plant.log").write_text("a line")
        assert record.read(directory).is_running
        assert record.read(directory).ending == "running"
        raise LinkLost("link.camera_silent", "no picture")

    with pytest.raises(LinkLost), run_directory(tmp_path) as directory:
        fail(directory)
    run = record.read(directory)
    assert (run.command, run.ending) == ("longreach demo --seed 3", "link.camera_silent: no picture")
    assert not run.is_running
    assert run.facts["machine"]["cores"] == len(os.sched_getaffinity(0))
    assert run.facts["libraries"]["numpy"]
    assert run.facts["took_s"] >= 0.0
    record.note(directory, verdict="within ±5 mm")
    assert record.read(directory).ending == "within ±5 mm"


def test_a_run_whose_process_has_gone_was_cut_off(tmp_path: Path) -> None:
    directory = made(tmp_path, "20261122-120000", process=2**22 + 1)
    facts = record.read(directory).facts
    (directory / record.RECORD_FILE).write_text(json.dumps({k: v for k, v in facts.items() if k != "took_s"}))
    assert record.read(directory).ending == "cut off"
    (directory / record.RECORD_FILE).write_text("{ half a")
    assert record.read(directory).ending == "run.json is damaged"


def test_what_is_not_as_shipped_is_listed_by_key(shipped_settings: Settings) -> None:
    other = load_settings(CONFIGS, {"plant": {"payload": {"mass_kg": 77.0}}, "vision": {"api": {"port": 1}}})
    changed = record.changed_settings(other, shipped_settings)
    shipped_kg = shipped_settings.plant.payload.mass_kg
    assert changed == {
        "plant.payload.mass_kg": (shipped_kg, 77.0),
        "vision.api.port": (shipped_settings.vision.api.port, 1),
    }
    assert record.changed_settings(shipped_settings, shipped_settings) == {}


def test_a_run_is_found_by_its_name_a_beginning_or_as_the_last(tmp_path: Path) -> None:
    old, new = made(tmp_path, "20261121-090000"), made(tmp_path, "20261122-090000")
    (tmp_path / "plant-survey").mkdir()
    assert [run.directory for run in all_runs(tmp_path)] == [new, old]
    assert one_run(tmp_path, "last").directory == new
    assert one_run(tmp_path, "20261121").directory == old
    for name, words in (("2026", "several"), ("1999", "no such run"), ("", "no such run")):
        with pytest.raises(ConfigurationError, match=words):
            one_run(tmp_path, name)
    with pytest.raises(ConfigurationError, match="no such directory"):
        all_runs(tmp_path / "nowhere")


def test_the_newest_run_is_the_one_that_began_last_whatever_the_clock_called_it(tmp_path: Path) -> None:
    """In the hour that clocks show twice, a later run has an earlier name."""
    made(tmp_path, "20261025-023000", began="2026-10-25T00:30:00Z")
    made(tmp_path, "20261025-021000", began="2026-10-25T01:10:00Z")
    (tmp_path / "20250101-000000").mkdir()  # no record: by its name
    assert [run.directory.name[-6:] for run in all_runs(tmp_path)] == ["021000", "023000", "000000"]
    assert one_run(tmp_path, "last").directory.name == "20261025-021000"
