"""The table of changed machines: changes the plant takes, told to nobody, and a verdict that can fail."""

from pathlib import Path
from typing import Any

import pytest
import typer

from foundation.configuration import merged, parse_overrides
from testbed.campaigns.campaign import CampaignRequest
from testbed.campaigns.experiment import Finished
from testbed.campaigns.row_file import RowFile
from testbed.campaigns.typed_rows import XYZ, flat, typed
from testbed.experiments.positioning import changed
from testbed.experiments.positioning.changed import (
    CHANGES,
    ChangedRow,
    ChangedSettings,
    changed_run,
    changed_table,
    changed_tasks,
    changed_verdict,
)
from testbed.experiments.positioning.corrected_run import Branch
from testbed.experiments.positioning.scenarios import draw
from testbed.experiments.positioning.told import Told
from testbed.experiments.positioning.worlds import WORLDS, WorldName
from testbed.scenarios.settings import load_settings
from tests.support.paths import CONFIGS

REQUEST = CampaignRequest(CONFIGS, Path("unused"), runs=2)


@pytest.mark.slow("every changed world is drawn")
def test_every_change_is_taken_by_a_drawn_world_and_told_to_nobody() -> None:
    drawn = draw(CONFIGS, 3, "plant", WORLDS[WorldName.LAB]).overrides
    plain = load_settings(CONFIGS, drawn)
    for name, change in CHANGES.items():
        assert all(assignment.startswith(("plant.", "scene.")) for assignment in change.assignments)
        settings = load_settings(CONFIGS, merged(drawn, parse_overrides(change.assignments)))
        assert (settings == plain) is (name == "nothing"), name
        assert (settings.arm, settings.controller, settings.vision) == (
            plain.arm,
            plain.controller,
            plain.vision,
        )


def test_an_unknown_change_is_refused_by_name() -> None:
    with pytest.raises(typer.BadParameter, match="worn_pins"):
        changed_tasks(REQUEST, ChangedSettings(["worn_pins"]))


def test_a_row_that_is_too_far_off_or_told_too_sure_fails_and_only_that() -> None:
    tasks = changed_tasks(REQUEST, ChangedSettings(["nothing", "deadband_1"]))
    assert len({task["key"] for task in tasks}) == len(tasks) == 4

    def row(task: dict[str, Any], error: float) -> ChangedRow:
        run = {f"run_look1_{part}_mm": error for part in ("worst", "true_x", "true_y")}
        std = {f"run_look1_std_{axis}_mm": 0.5 for axis in "xy"}
        return typed(ChangedRow, {"change": task["change"], **run, **std})

    rows = [row(task, 0.4 if task["change"] == "nothing" else 5.5) for task in tasks]
    done = Finished(REQUEST, ChangedSettings(), tasks, rows, 0)
    failed = [check.what for check in changed_verdict(done) if check.met is False]
    assert failed == [
        "deadband_1: share within 5 mm",
        "deadband_1: median",
        "deadband_1: error over told σ, at most",
    ]
    (shown,) = changed_table(done)
    assert list(shown.columns[2].cells) == ["0.40", "5.50"]
    assert list(shown.columns[6].cells) == ["0", "2"], "nobody was warned of either"


def test_a_row_that_was_measured_is_read_back_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    branch = Branch(true_mm=XYZ(0.3, -0.4, 1.0), worst_mm=0.4, before=Told(probability=0.97), steps=2)
    measured = {"seed": 7, "arm": "plant", "look1": branch, "look2": Branch(failure="motion.not_settled: x")}
    monkeypatch.setattr(changed, "one_run", lambda config_dir, task: measured)
    (task,) = changed_tasks(REQUEST._replace(runs=1), ChangedSettings(["deadband_1"]))
    kept = RowFile(tmp_path / "rows.csv").append(flat(changed_run(CONFIGS, task)))
    row = typed(ChangedRow, kept)
    assert (row.change, row.run.seed) == ("deadband_1", 7)
    assert repr(row.run.look1) == repr(branch), "and what is NaN is NaN again"
    assert row.run.look2.failure == "motion.not_settled: x"


@pytest.mark.parametrize("name", ["adapting", "commissioned"])
def test_what_is_asked_for_reaches_every_task_and_nothing_else_does(name: str) -> None:
    tasks = changed_tasks(REQUEST, ChangedSettings(["nothing"], **{name: True}))
    assert all(task[name] is True for task in tasks)
    other = {"adapting", "commissioned"} - {name}
    assert not any(other & set(task) for task in tasks)
    assert not any(
        {"adapting", "commissioned"} & set(task) for task in changed_tasks(REQUEST, ChangedSettings())
    )
