"""A campaign's rows: one a run, typed, resumed and not repeated, with failures told and never numbers."""

import math
import os
import shutil
import time
from functools import partial
from pathlib import Path
from typing import Any

import distributed
import pytest

from laboratory.campaigns import campaign, workforce
from laboratory.campaigns.campaign import (
    CampaignRequest,
    configuration_of,
    evidence_of,
)
from laboratory.campaigns.rows import RowFile
from laboratory.campaigns.workforce import REACH_S
from protocol.errors import ConfigurationError, LinkLost, MeasurementFailed

pytestmark = pytest.mark.slow("campaigns start processes")


def run_campaign(
    directory: Path,
    function: Any,
    tasks: list[dict[str, Any]],
    *,
    scheduler: str | None,
    title: str,
    workers: int = 2,
    fresh: bool = False,
) -> list[dict[str, Any]]:
    """The rows of a campaign."""
    request = CampaignRequest(Path("configs"), directory, scheduler=scheduler, workers=workers, fresh=fresh)
    return campaign.run_campaign(request, function, tasks, title).rows


def measured(task: dict[str, Any]) -> dict[str, Any]:
    """A run that tells which process did it, fails for odd numbers, and breaks or dies when told to."""
    if task.get("odd"):
        raise MeasurementFailed("measurement.object_not_seen", "seen in 0 of 10 pictures\nand no more")
    if task.get("broken"):
        raise ZeroDivisionError("a bug")
    if task.get("dies"):
        os._exit(1)
    file = bytes([task["number"]])
    return {"twice": 2 * task["number"], "process": os.getpid(), "nothing": math.nan, "trace.bin": file}


def resigning(task: dict[str, Any]) -> dict[str, Any]:
    """A run during which its worker leaves the cluster for good."""
    worker = distributed.get_worker()
    worker.loop.add_callback(worker.close)
    time.sleep(1.0)
    return {}


def scaled(factor: float, task: dict[str, Any]) -> dict[str, Any]:
    return {"value": factor * task["number"]}


def tasks(count: int, **more: Any) -> list[dict[str, Any]]:
    return [{"key": f"run-{n}", "number": n, "odd": n % 2 == 1} | more for n in range(count)]


def test_a_campaign_runs_in_processes_of_its_own_resumes_and_tells_failures(tmp_path: Path) -> None:
    rows = run_campaign(tmp_path, measured, tasks(4), scheduler=None, title="four")
    assert [row["key"] for row in rows] == ["run-0", "run-1", "run-2", "run-3"]
    assert [row["twice"] for row in rows] == [0, None, 4, None]
    assert rows[1]["failure"] == "measurement.object_not_seen: seen in 0 of 10 pictures\nand no more"
    assert rows[0]["failure"] is None
    assert rows[0]["nothing"] is None
    assert (tmp_path / rows[2]["trace.bin"]).read_bytes() == b"\x02"
    assert rows[0]["process"] != os.getpid()
    assert all(row["run_s"] >= 0.0 and row["cpu_s"] >= 0.0 for row in rows)
    assert sorted(RowFile(tmp_path / "rows.csv").rows, key=lambda row: row["key"]) == rows
    # what is done is not done again, not even what failed: with the scheduler gone, nothing is asked of it
    again = run_campaign(tmp_path, measured, tasks(4), scheduler="nonsense://x", title="four")
    assert again == rows


def test_a_lost_worker_and_a_bug_are_told_and_tried_again_when_resumed(tmp_path: Path) -> None:
    broken = [{"key": "a", "number": 1, "broken": True}, {"key": "b", "number": 2, "dies": True}]
    first, second = run_campaign(tmp_path, measured, broken, scheduler=None, title="broken", workers=1)
    assert first["failure"] == "campaign.exception: ZeroDivisionError: a bug"
    assert second["failure"].startswith("campaign.worker_lost: ")
    with pytest.raises(ConfigurationError):  # so it would have been run
        run_campaign(tmp_path, measured, broken, scheduler="nonsense://x", title="broken")


def test_an_existing_scheduler_does_the_runs(tmp_path: Path) -> None:
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0",
        protocol="tcp", host="127.0.0.1",
    ) as cluster:  # fmt: skip
        address = cluster.scheduler_address
        rows = run_campaign(tmp_path, partial(scaled, 0.5), tasks(3), scheduler=address, title="three")
        assert [row["value"] for row in rows] == [0.0, 0.5, 1.0]


def test_workers_that_are_all_gone_are_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workforce, "_PATIENCE_S", 1.0)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0",
        protocol="tcp", host="127.0.0.1",
    ) as cluster, pytest.raises(LinkLost) as refused:  # fmt: skip
        run_campaign(tmp_path, resigning, tasks(3), scheduler=cluster.scheduler_address, title="three")
    assert refused.value.cause == "link.workers_lost"


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("scheduler", "cause"),
    [("tcp://127.0.0.1:9", "link.scheduler_unreachable"), ("nonsense://x", "configuration.bad_address")],
)
def test_a_scheduler_that_is_not_there_is_told_soon(tmp_path: Path, scheduler: str, cause: str) -> None:
    began = time.monotonic()
    with pytest.raises((LinkLost, ConfigurationError)) as refused:
        run_campaign(tmp_path, measured, tasks(1), scheduler=scheduler, title="none")
    assert refused.value.cause == cause
    assert scheduler in str(refused.value)
    assert time.monotonic() - began < REACH_S + 5.0


def test_a_key_given_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as refused:
        run_campaign(tmp_path, measured, [*tasks(1), *tasks(1)], scheduler=None, title="twice")
    assert refused.value.cause == "configuration.duplicate_task"


def test_the_configuration_is_the_function_what_is_bound_to_it_and_the_task() -> None:
    task = {"key": "a", "number": 1}

    def hashed(function: Any, task: dict[str, Any] = task) -> str:
        return configuration_of(evidence_of(function), task)

    assert hashed(partial(scaled, 0.5)) == hashed(partial(scaled, 0.5), dict(task))
    others = {
        hashed(partial(scaled, 0.5)),
        hashed(partial(scaled, 0.6)),
        hashed(measured),
        hashed(measured, task | {"number": 2}),
    }
    assert len(others) == 4


def read(config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """A run that reads a configuration file."""
    return {"value": (config_dir / "plant.yaml").read_text()}


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
    asked, function = tasks(1, scenario="one"), partial(read, configured)
    rows = run_campaign(tmp_path, function, asked, scheduler=None, workers=0, title="one")
    assert run_campaign(tmp_path, function, asked, scheduler=MEASURES, title="one") == rows
    (configured / edited).write_text("mass_kg: 2.0\n")
    with pytest.raises(ConfigurationError):
        run_campaign(tmp_path, function, asked, scheduler=MEASURES, title="one")


def test_the_same_files_elsewhere_are_the_same_evidence(tmp_path: Path, configured: Path) -> None:
    copied = shutil.copytree(configured, tmp_path / "elsewhere")
    assert evidence_of(partial(read, configured)) == evidence_of(partial(read, copied))


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
    tmp_path: Path, configured: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    function = partial(read, configured)
    evidence = evidence_of(function)
    monkeypatch.setattr(campaign, "evidence_of", lambda function: evidence | {"sources": "0"})
    (row,) = run_campaign(tmp_path, function, tasks(1), scheduler=None, workers=1, title="one")
    assert row["failure"] == "campaign.other_worker: the worker's sources are not those of the client"


def test_fresh_measures_what_is_there(tmp_path: Path) -> None:
    run_campaign(tmp_path, measured, tasks(1), scheduler=None, workers=0, title="one")
    (second,) = run_campaign(tmp_path, measured, tasks(1), scheduler=None, workers=0, title="one", fresh=True)
    assert second["run_s"] is not None
    assert len(RowFile(tmp_path / "rows.csv").rows) == 2
    assert run_campaign(tmp_path, measured, tasks(1), scheduler=MEASURES, title="one") == [second]


@pytest.mark.parametrize(
    "value",
    ["", "plain", "1", "1e5", "true", "nan", "two\nlines", 'quo"te, comma', "[1]", "é", 0, -7, 1.5, 1e-300,
     True, False, None, [1, 2.5, "x"]],
)  # fmt: skip
def test_a_row_is_read_back_as_it_was_written(tmp_path: Path, value: object) -> None:
    file = RowFile(tmp_path / "rows.csv")
    kept = file.append({"key": "a", "value": value})
    file.append({"key": "b", "later": 2})
    read = RowFile(tmp_path / "rows.csv").rows
    assert kept["value"] == (None if value == "" else value)
    assert type(kept["value"]) is (type(None) if value == "" else type(value))
    assert read == [
        {"key": "a", "value": kept["value"], "later": None},
        {"key": "b", "value": None, "later": 2},
    ]


def test_a_line_that_was_cut_off_is_dropped_and_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    file = RowFile(path)
    file.append({"key": "a", "value": 1})
    file.append({"key": "b", "value": 2})
    path.write_bytes(path.read_bytes()[:-2])
    file = RowFile(path)
    assert [row["key"] for row in file.rows] == ["a"]
    file.append({"key": "c", "value": 3})
    assert path.read_text() == "key,value\na,1\nc,3\n"
