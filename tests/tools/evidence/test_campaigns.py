"""docs/evidence.md is what its rows say, rows that are kept are read again, superseded ones leave a line."""

import csv
import json
from pathlib import Path

import pytest

from testbed.campaigns.row_file import RowFile
from testbed.campaigns.typed_rows import XYZ, flat
from testbed.experiments.positioning.corrected_run import Branch, PositioningRow
from testbed.experiments.positioning.told import Told
from tools.evidence.campaigns import supersede
from tools.evidence.kept_rows import RESULTS, ROOT, committed, keep
from tools.evidence.pages import PAGES, sections
from tools.protocol_page import filled


@pytest.fixture(scope="module")
def made() -> dict[str, str]:
    return sections()


@pytest.mark.slow("every row of every campaign is read")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_tables_are_those_of_the_rows(page: Path, made: dict[str, str]) -> None:
    text = page.read_text(encoding="utf-8")
    assert filled(text, made) == text, "run: python -m tools.evidence"


def test_every_table_is_on_a_page(made: dict[str, str]) -> None:
    texts = [page.read_text(encoding="utf-8") for page in PAGES[1:]]
    for name in made:
        assert sum(text.count(f"<!-- generated: {name} -->") for text in texts) == 1, name


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
    made = sections(tmp_path / "results")["target scenes"]
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
    few = sections(results)["hole drives"]
    assert "| `lab`, 4 m arm | one look, one hole | 150 | 1.000 | " in few
    assert "| ≥ 0.98 of 200 | too few to say |" in few
    keep(_driven(tmp_path / "b", ["lab"] * 50, [None] + [0.5] * 49), "b", "abc1234", typed_in, results)
    keep(_driven(tmp_path / "c", ["real"], [0.4]), "c", "abc1234", f"{typed_in} --world real", results)
    made = sections(results)["hole drives"].splitlines()
    assert made[2].startswith("| `lab`, 4 m arm | one look, one hole | 200 | 0.995 | ")
    assert made[2].endswith("| ≥ 0.98 of 200 | yes |")
    assert made[3].startswith("| `real`, 4 m arm | one look, one hole | 1 | 1.000 | ")
    assert made[3].endswith("|  |  |")
    assert any(line.endswith("| 50 | 50 | 49 | 0.50, 0.50, 0.50 | 1: `target.no_hole` |") for line in made)


def _superseded(results: Path) -> list[dict[str, str]]:
    with (results / "superseded.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_superseded_campaign_leaves_a_line_with_the_reason_and_its_verdict(tmp_path: Path) -> None:
    run, results = tmp_path / "run", tmp_path / "results"
    run.mkdir()
    _campaign(run, [_row(1, 0.4, 0.99)])
    driven = _driven(tmp_path / "a", ["lab"], [9.0])
    keep(run, "real", "abc1234", "longreach experiment best-mode", results)
    keep(driven, "a", "abc1235", "longreach experiment hole-drives", results)
    supersede("real", "it parks now", "def5678", results)
    supersede("a", "the hole was hidden", "def5679", results)
    assert sections(results)["evidence"].count("\n") == 1, "no line of rows that count"
    assert "9.00" not in sections(results)["hole drives"]
    assert [path.name for path in results.iterdir()] == ["superseded.csv"]
    first, second = _superseded(results)
    assert list(first.values()) == [
        *("real", "longreach experiment best-mode", "abc1234", "1", "6 of 8", "it parks now", "def5678")
    ]
    assert second["since"] == "the hole was hidden"


def test_no_campaign_counts_and_is_superseded() -> None:
    names = [line["rows"] for line in _superseded(RESULTS)]
    assert len(set(names)) == len(names)
    assert not [name for name in names if (RESULTS / name).exists()]


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a git clone")
def test_rows_that_git_has_not_got_are_not_taken_away() -> None:
    with pytest.raises(SystemExit, match="git has no docs/results/nowhere"):
        committed("nowhere")


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
