"""Tables of results are those of the rows that are kept; rows are kept only beside what made them."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from protocol.errors import ConfigurationError
from testbed.campaigns.row_file import RowFile
from tools.results_page import PAGES, RESULTS, _evidence, best_mode, keep, kept, rendered

ROW = {"seed": 7, "arm": "plant", "world": "lab", "look1_worst_mm": 0.123456789, "look1_true_x_mm": 0.1}


def git(root: Path, *words: str) -> None:
    who = ["-c", "user.name=x", "-c", "user.email=x@example.org"]
    subprocess.run(["git", *who, *words], cwd=root, check=True, capture_output=True)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A checkout with a configuration, all of it committed."""
    (tmp_path / "configs").mkdir()
    (tmp_path / "configs" / "plant.yaml").write_text("step_ms: 0.5\n", encoding="utf-8")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "as it was")
    return tmp_path


def campaign(root: Path, *rows: dict[str, Any]) -> Path:
    """A directory of rows that were made on ``root``."""
    directory = root / "runs"
    directory.mkdir()
    noted = []
    for row in rows:
        code = f"c{row['seed']}"
        RowFile(directory / "rows.csv").append(
            {"key": f"k{row['seed']}", "configuration": code, "run_s": 1.0} | row
        )
        task = {"eyes": "model", "assignments": ["plant.payload.mass_kg=30"]}
        noted.append(json.dumps({"configuration": code, "task": task} | _evidence(root)) + "\n")
    (directory / "tasks.jsonl").write_text("".join(noted), encoding="utf-8")
    return directory


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.name}")
def test_the_tables_are_those_of_the_rows(page: Path) -> None:
    assert rendered(page) == page.read_text(encoding="utf-8"), "run: python -m tools.results_page"


def test_every_kept_row_tells_seed_commit_and_configuration() -> None:
    for path in RESULTS.glob("*.csv"):
        for row in RowFile(path).rows:
            assert isinstance(row["seed"], int)
            assert len(str(row["commit"])) == 10
            assert len(str(row["configuration"])) == 12


def test_rows_are_kept_with_the_commit_and_come_back(root: Path) -> None:
    path = keep(campaign(root, ROW | {"seed": 8}, ROW), "best_mode_x", root / "results", root)
    file = kept(path)
    assert [row.seed for row in file.rows] == [7, 8]
    assert file.rows[0].look1.worst_mm == 0.123457
    assert (file.eyes, file.assignments, file.world) == ("model", "plant.payload.mass_kg=30", "lab")
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, check=True)
    assert head.stdout.startswith(file.commit)
    made = best_mode([file], "here/")
    assert "| 2, 7 to 8 | model | 0 of 2; nan / nan mm | 2 of 2; 0.12 / 0.12 mm |" in made
    assert "not met: " in made
    assert f"{file.commit}, [best_mode_x.csv](here/best_mode_x.csv)" in made


def test_rows_of_another_configuration_and_changed_files_are_refused(root: Path) -> None:
    directory = campaign(root, ROW)
    (root / "configs" / "plant.yaml").write_text("step_ms: 0.4\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"configs/plant\.yaml") as caught:
        keep(directory, "x", root / "results", root)
    assert caught.value.cause == "results.changed_files"
    git(root, "commit", "-qam", "another step")
    with pytest.raises(ConfigurationError, match="k7: bound here are not those") as caught:
        keep(directory, "x", root / "results", root)
    assert caught.value.cause == "results.other_sources"
    with pytest.raises(ConfigurationError) as caught:
        keep(root, "x", root / "results", root)
    assert caught.value.cause == "results.no_rows"
    assert not list(root.glob("results/*"))


def test_rows_of_two_commits_do_not_make_one_table(root: Path) -> None:
    path = keep(campaign(root, ROW), "best_mode_x", root / "results", root)
    RowFile(path).append({"seed": 9, "commit": "0123456789", "eyes": "model", "set": "", "world": "lab"})
    with pytest.raises(ConfigurationError, match="several commits"):
        kept(path)
