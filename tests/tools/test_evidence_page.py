"""docs/evidence.md and its history are what their rows say, and rows that are kept are read again."""

import json
from pathlib import Path

import pytest

from testbed.campaigns.row_file import RowFile
from testbed.campaigns.typed_rows import XYZ, flat
from testbed.experiments.positioning.corrected_run import Branch, PositioningRow
from testbed.experiments.positioning.told import Told
from tools import sight_pages
from tools.evidence_page import PAGES, keep, rendered, sections


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_tables_are_those_of_the_rows(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert rendered(text) == text, "run: python -m tools.evidence_page"


def test_every_table_is_on_one_page() -> None:
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    for name in sections():
        assert sum(f"<!-- generated: {name} -->" in text for text in texts) == 1, name


@pytest.mark.parametrize("page", sight_pages.PAGES, ids=lambda page: page.stem)
def test_the_tables_of_targets_and_markers_are_those_of_the_rows(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert sight_pages.rendered(text) == text, "run: python -m tools.sight_pages"


def test_rows_of_targets_stand_on_their_own_page_with_wrong_answers_told(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    file = RowFile(run / "rows.csv")
    told = {"seen_nees": 1.0, "known_nees": 1.0, "seen_nees_depth": 1.0, "measure_ms": 5.0}
    errors = {
        f"{which}_{name}": 0.3
        for which in ("seen", "known")
        for name in ("lateral_mm", "normal_deg", "depth_mm")
    }
    for seed in range(3):
        file.append({"row": "plane-2.0", "seed": seed, "refused": None, "wrong": False} | told | errors)
    file.append({"row": "repetitive", "seed": 1, "refused": None, "wrong": True, "measure_ms": 5.0})
    (run / "tasks.jsonl").write_text("{}\n", encoding="utf-8")
    keep(run, "scenes", "abc1234", "longreach experiment targets --runs 3", tmp_path / "results")
    assert "abc1234" not in sections(tmp_path / "results")["other campaigns"]
    made = sight_pages.sections(tmp_path / "results")["target scenes"]
    assert "| click, 2 m | 3 | 3 |  | 0.30, 0.30 |" in made
    assert "| 6 of 6 |" in made
    assert "| click on a chessboard | 1 | 1, wrong: 1 |" in made
    assert "| 0 of 1 |" in made


def _driven(directory: Path, worlds: list[str], worst_mm: list[float | None]) -> Path:
    """The rows of a campaign of drives to one hole each."""
    directory.mkdir()
    file = RowFile(directory / "rows.csv")
    for seed, (world, worst) in enumerate(zip(worlds, worst_mm, strict=True)):
        cells = {"seed": seed, "world": world, "arm": "plant", "holes": 1, "hole1_worst_mm": worst}
        file.append(cells | {"hole1_failure": "target.no_hole: none" if worst is None else None})
    (directory / "tasks.jsonl").write_text("{}\n", encoding="utf-8")
    return directory


def test_drives_of_a_kind_are_judged_together_and_never_by_few_nor_by_another_worlds_limit(
    tmp_path: Path,
) -> None:
    results, typed_in = tmp_path / "results", "longreach experiment hole-drives"
    keep(_driven(tmp_path / "a", ["lab"] * 150, [0.5] * 150), "a", "abc1234", f"{typed_in} --seed 1", results)
    few = sight_pages.sections(results)["hole drives"]
    assert "| `lab`, 4 m arm | one look, one hole | 150 | 1.000 | " in few
    assert "| ≥ 0.98 of 200 | too few to say |" in few
    keep(_driven(tmp_path / "b", ["lab"] * 50, [None] + [0.5] * 49), "b", "abc1234", typed_in, results)
    keep(_driven(tmp_path / "c", ["real"], [0.4]), "c", "abc1234", f"{typed_in} --world real", results)
    made = sight_pages.sections(results)["hole drives"].splitlines()
    assert made[2].startswith("| `lab`, 4 m arm | one look, one hole | 200 | 0.995 | ")
    assert made[2].endswith("| ≥ 0.98 of 200 | yes |")
    assert made[3].startswith("| `real`, 4 m arm | one look, one hole | 1 | 1.000 | ")
    assert made[3].endswith("|  |  |")
    assert any(line.endswith("| 50 | 50 | 49 | 0.50, 0.50, 0.50 | 1: `target.no_hole` |") for line in made)


def test_rows_that_no_longer_count_are_history_with_the_reason_and_their_verdict(tmp_path: Path) -> None:
    run, results = tmp_path / "run", tmp_path / "results"
    run.mkdir()
    _campaign(run, [_row(1, 0.4, 0.99)])
    into = keep(run, "real", "abc1234", "longreach experiment best-mode", results)
    about = json.loads((into / "about.json").read_text(encoding="utf-8"))
    (into / "about.json").write_text(json.dumps(about | {"superseded": "it parks now"}), encoding="utf-8")
    made = sections(results)
    assert made["evidence"].count("\n") == 1, "no line of rows that count"
    line = made["history"].splitlines()[-1]
    assert line.startswith(
        "| `docs/results/real`, commit `abc1234` | `longreach experiment best-mode` | 1 | "
    )
    assert line.endswith("| 6 of 8 | it parks now |")


def test_drives_that_were_superseded_are_history_too_and_not_counted(tmp_path: Path) -> None:
    results = tmp_path / "results"
    into = keep(
        _driven(tmp_path / "a", ["lab"], [9.0]), "a", "abc1234", "longreach experiment hole-drives", results
    )
    about = json.loads((into / "about.json").read_text(encoding="utf-8"))
    (into / "about.json").write_text(
        json.dumps(about | {"superseded": "the hole was hidden"}), encoding="utf-8"
    )
    keep(_driven(tmp_path / "b", ["lab"], [0.5]), "b", "abc1234", "longreach experiment hole-drives", results)
    counted = sight_pages.sections(results)["hole drives"]
    assert "| `lab`, 4 m arm | one look, one hole | 1 | 1.000 | " in counted
    assert "9.00" not in counted
    history = sections(results)["history"].splitlines()[2:]
    assert [line.endswith("| the hole was hidden |") for line in history] == [True]


def _row(seed: int, error_mm: float, probability: float, failure: str = "") -> PositioningRow:
    told = Told(probability=probability, std_x_mm=0.5, std_y_mm=0.5, distance2=2.0, level2=5.99)
    true, std = XYZ(error_mm, 0.0, 0.0), XYZ(0.5, 0.5, 1.0)
    seen = told._replace(probability=0.9 if error_mm < 7.5 else 0.1)
    end = Branch(true, std_mm=std, worst_mm=error_mm, before=told, after=seen)
    stopped = Branch(failure="motion.not_settled: x")
    first = stopped if failure else end
    return PositioningRow(seed, "plant", 0.0, 0.0, 0.0, 0.0, 0.0, "real", look1=first, look2=first)


def _campaign(directory: Path, rows: list[PositioningRow], changes: list[str] | None = None) -> Path:
    file = RowFile(directory / "rows.csv")
    for number, row in enumerate(rows):
        columns = flat(row)
        if changes:
            columns = {"change": changes[number], **{f"run_{name}": cell for name, cell in columns.items()}}
        file.append(columns)
    (directory / "tasks.jsonl").write_text(json.dumps({"configuration": "1"}) + "\n", encoding="utf-8")
    return directory


def test_rows_that_are_kept_are_counted_with_their_stops_and_silent_misses(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    _campaign(run, [_row(1, 0.4, 0.99), _row(2, 7.0, 0.99), _row(3, 8.0, 0.5), _row(4, 0.0, 1.0, "stopped")])
    keep(run, "real", "abc1234", "longreach experiment best-mode", tmp_path / "results")
    line = sections(tmp_path / "results")["evidence"].splitlines()[-1]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[:4] == [
        "`docs/results/real`, commit `abc1234`",
        "`longreach experiment best-mode`",
        "4",
        "25%",
    ]
    assert cells[4].startswith("7.00, ")
    assert cells[7] == "1", "stopped"
    assert cells[10] == "1, 1", "the one that was told 0.5 before moving, 0.1 by odometry, was none"


@pytest.mark.parametrize(("error_mm", "verdict"), [(0.4, "yes"), (1.6, "NO"), (5.5, "NO")])
def test_a_changed_machine_has_its_verdict(tmp_path: Path, error_mm: float, verdict: str) -> None:
    run = tmp_path / "run"
    run.mkdir()
    _campaign(run, [_row(1, error_mm, 0.99)], ["deadband_1"])
    keep(run, "changed", "abc1234", "longreach experiment changed-machine", tmp_path / "results")
    made = sections(tmp_path / "results")
    assert made["changed machines"].splitlines()[-1].endswith(f"| {verdict} |")
    assert "abc1234" in made["changed machines"]
    assert made["evidence"].count("\n") == 1, "no line of drawn machines"
