"""A campaign's rows: one a run, typed, resumed and not repeated, with failures told and never numbers."""

import math
import os
import shutil
import threading
import time
from pathlib import Path
from typing import Any

import distributed
import numpy as np
import pytest

from laboratory.campaigns import campaign
from laboratory.campaigns.campaign import (
    CampaignRequest,
    configuration_of,
    evidence_of,
)
from laboratory.campaigns.rows import column, read_rows, write_rows
from laboratory.campaigns.workforce import REACH_S
from protocol.errors import ConfigurationError, LinkLost, MeasurementFailed

pytestmark = pytest.mark.slow("campaigns start processes")


CONFIGURED = Path("tests/laboratory/campaigns")  # any small directory


def run_campaign(
    out: Path, run: Any, tasks: list[dict[str, Any]], config_dir: Path = CONFIGURED, **options: Any
) -> list[dict[str, Any]]:
    """The rows of a campaign."""
    return campaign.run_campaign(CampaignRequest(config_dir, out, **options), run, tasks, "test")[0]


def measured(_config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """A run that tells which process did it, fails for odd numbers, and breaks or dies when told to."""
    if task.get("odd"):
        raise MeasurementFailed("measurement.object_not_seen", "seen in 0 of 10 pictures\nand no more")
    if task.get("broken"):
        raise ZeroDivisionError("a bug")
    if task.get("dies"):
        os._exit(1)
    time.sleep(task.get("seconds", 0.0))
    return {"twice": 2 * task["number"], "process": os.getpid(), "nothing": math.nan}


def tasks(count: int, **more: Any) -> list[dict[str, Any]]:
    return [{"key": f"run-{n}", "number": n, "odd": n % 2 == 1} | more for n in range(count)]


def test_a_campaign_runs_in_processes_of_its_own_resumes_and_tells_failures(tmp_path: Path) -> None:
    rows = run_campaign(tmp_path, measured, tasks(4))
    assert [row["key"] for row in rows] == ["run-0", "run-1", "run-2", "run-3"]
    assert [row["twice"] for row in rows] == [0, None, 4, None]
    assert rows[1]["failure"] == "measurement.object_not_seen: seen in 0 of 10 pictures\nand no more"
    assert rows[0]["failure"] is None
    assert rows[0]["nothing"] is None
    assert rows[0]["process"] != os.getpid()
    assert all(row["run_s"] >= 0.0 and row["cpu_s"] >= 0.0 for row in rows)
    assert sorted(read_rows(tmp_path / "rows.csv"), key=lambda row: row["key"]) == rows
    # what is done is not done again, not even what failed: with the scheduler gone, nothing is asked of it
    assert run_campaign(tmp_path, measured, tasks(4), scheduler=MEASURES) == rows


def test_a_lost_worker_and_a_bug_are_told_and_tried_again_when_resumed(tmp_path: Path) -> None:
    broken = [{"key": "a", "number": 1, "broken": True}, {"key": "b", "number": 2, "dies": True}]
    first, second = run_campaign(tmp_path, measured, broken, workers=1)
    assert first["failure"] == "campaign.exception: ZeroDivisionError: a bug"
    assert second["failure"].startswith("campaign.worker_lost: ")
    with pytest.raises(ConfigurationError):  # so it would have been run
        run_campaign(tmp_path, measured, broken, scheduler=MEASURES)


def cluster() -> Any:
    """A cluster of one worker, in this process."""
    return distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0",
        protocol="tcp", host="127.0.0.1",
    )  # fmt: skip


def test_an_existing_scheduler_does_the_runs_until_it_goes_away(tmp_path: Path) -> None:
    with cluster() as there:
        rows = run_campaign(tmp_path, measured, tasks(3), scheduler=there.scheduler_address)
        assert [row["twice"] for row in rows] == [0, None, 4]
        threading.Timer(1.0, there.close).start()
        long = {"key": "last", "number": 1, "seconds": 3.0}
        with pytest.raises(LinkLost) as refused:
            run_campaign(tmp_path, measured, [long], scheduler=there.scheduler_address)
    assert refused.value.cause == "link.scheduler_lost"
    assert len(read_rows(tmp_path / "rows.csv")) == 3


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("scheduler", "cause"),
    [("tcp://127.0.0.1:9", "link.scheduler_unreachable"), ("nonsense://x", "configuration.bad_address")],
)
def test_a_scheduler_that_is_not_there_is_told_soon(tmp_path: Path, scheduler: str, cause: str) -> None:
    began = time.monotonic()
    with pytest.raises((LinkLost, ConfigurationError)) as refused:
        run_campaign(tmp_path, measured, tasks(1), scheduler=scheduler)
    assert refused.value.cause == cause
    assert scheduler in str(refused.value)
    assert time.monotonic() - began < REACH_S + 5.0


def test_a_key_given_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as refused:
        run_campaign(tmp_path, measured, [*tasks(1), *tasks(1)])
    assert refused.value.cause == "configuration.duplicate_task"


def test_the_configuration_is_the_function_the_files_and_the_task(configured: Path, tmp_path: Path) -> None:
    copied = shutil.copytree(configured, tmp_path / "elsewhere")

    def hashed(function: Any, config_dir: Path = configured, **task: Any) -> str:
        return configuration_of(evidence_of(function, config_dir), {"key": "a", "number": 1} | task)

    assert hashed(measured) == hashed(measured, copied), "the same files elsewhere are the same evidence"
    assert len({hashed(measured), hashed(tasks), hashed(measured, number=2)}) == 3


MEASURES = "nonsense://x"
"""A scheduler that is refused as soon as anything is to be measured."""


@pytest.fixture
def configured(tmp_path: Path) -> Path:
    """A configuration directory."""
    config_dir = tmp_path / "configs"
    (config_dir / "scenarios").mkdir(parents=True)
    (config_dir / "plant.yaml").write_text("mass_kg: 1.0\n")
    (config_dir / "scenarios" / "one.yaml").write_text("a: 1\n")
    return config_dir


@pytest.mark.parametrize("edited", ["plant.yaml", "scenarios/one.yaml", "new.yaml"])
def test_an_edited_configuration_file_measures_anew(tmp_path: Path, configured: Path, edited: str) -> None:
    rows = run_campaign(tmp_path, measured, tasks(1), configured, workers=0)
    (configured / "program.cpython-311.pyc").write_bytes(b"written by a worker")
    assert run_campaign(tmp_path, measured, tasks(1), configured, scheduler=MEASURES) == rows
    (configured / edited).write_text("mass_kg: 2.0\n")
    with pytest.raises(ConfigurationError):
        run_campaign(tmp_path, measured, tasks(1), configured, scheduler=MEASURES)


def test_an_edited_source_file_measures_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "vision_pc"
    package.mkdir()
    (package / "__init__.py").write_text("")
    monkeypatch.setattr(campaign, "_ROOT", tmp_path)
    before = campaign.sources_hash.__wrapped__()
    assert campaign.sources_hash.__wrapped__() == before
    (package / "far.py").write_text("VALUE = 1\n")
    assert campaign.sources_hash.__wrapped__() != before


def test_a_worker_with_other_sources_or_files_makes_no_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    evidence = evidence_of(measured, CONFIGURED)
    monkeypatch.setattr(campaign, "evidence_of", lambda *_: evidence | {"sources": "0"})
    (row,) = run_campaign(tmp_path, measured, tasks(1), workers=1)
    assert row["failure"] == "campaign.other_worker: the worker's sources are not those of the client"


def test_fresh_measures_what_is_there(tmp_path: Path) -> None:
    run_campaign(tmp_path, measured, tasks(1), workers=0)
    (second,) = run_campaign(tmp_path, measured, tasks(1), workers=0, fresh=True)
    assert len(read_rows(tmp_path / "rows.csv")) == 2
    assert run_campaign(tmp_path, measured, tasks(1), scheduler=MEASURES) == [second]


@pytest.mark.parametrize(
    "value",
    ["", "plain", "1", "1e5", "true", "nan", "two\nlines", 'quo"te, comma', "[1]", "é", 0, -7, 1.5, 1e-300,
     True, False, None, [1, 2.5, "x"]],
)  # fmt: skip
def test_a_row_is_read_back_as_it_was_written(tmp_path: Path, value: object) -> None:
    path = tmp_path / "rows.csv"
    write_rows(path, [{"key": "a", "value": value}, {"key": "b", "later": 2}])
    first, second = read_rows(path)
    assert first == {"key": "a", "value": None if value == "" else value, "later": None}
    assert type(first["value"]) is (type(None) if value == "" else type(value))
    assert second == {"key": "b", "value": None, "later": 2}
    np.testing.assert_array_equal(column([first, second], "later"), [np.nan, 2.0])
