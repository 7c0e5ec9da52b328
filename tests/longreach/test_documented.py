"""README, how-to page and examples say what they do: all of them are run as they stand."""

import ast
import json
import re
import runpy
import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pytest

from tests.support.pages import page
from tests.support.paths import ROOT

pytestmark = [pytest.mark.slow("examples run as they stand"), pytest.mark.timeout(600)]

BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
README = BLOCK.findall((ROOT / "README.md").read_text(encoding="utf-8"))
HOW_TO = BLOCK.findall(page("how_to/use_from_python.md"))
EXAMPLES = ROOT / "examples" / "python"


@pytest.fixture(autouse=True)
def in_the_repository(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def printed(script: Path, capsys: pytest.CaptureFixture[str]) -> list[float]:
    """The numbers that a script prints."""
    runpy.run_path(str(script), run_name="__main__")
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", capsys.readouterr().out)]


def ran(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> list[float]:
    script = tmp_path / "block.py"
    script.write_text(text, encoding="utf-8")
    return printed(script, capsys)


def test_the_readme_measures_what_is_true(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = README
    measured, true = (lambda n: (n[:3], n[3:]))(ran(block, tmp_path, capsys))
    assert len(measured) == len(true) == 3
    assert measured == pytest.approx(true, abs=5.0)  # mm
    assert max(map(abs, true)) > 100.0


def test_every_block_of_the_page_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert len(HOW_TO) == 4
    believed_and_true = ran(HOW_TO[0], tmp_path, capsys)
    assert believed_and_true[:3] == pytest.approx(believed_and_true[3:], abs=0.1)  # m
    (miss_m,) = re.findall(r"[-\d.e]+", str(ran_text(HOW_TO[1], tmp_path, capsys)))
    assert 0.0 <= float(miss_m) < 0.01
    assert ran(HOW_TO[2], tmp_path, capsys)[:2] == [6.0, 6.0]
    assert ran_text(HOW_TO[3], tmp_path, capsys) == "refused.disabled\n"


def ran_text(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    script = tmp_path / "block.py"
    script.write_text(text, encoding="utf-8")
    runpy.run_path(str(script), run_name="__main__")
    return capsys.readouterr().out


def shown(
    name: str, picture: Path, capsys: pytest.CaptureFixture[str], patch: pytest.MonkeyPatch
) -> list[float]:
    """The numbers that an example prints; ``picture`` is drawn by it, and is one."""
    patch.setattr(sys, "argv", [name, str(picture)])
    patch.setenv("MPLBACKEND", "Agg")
    try:
        found = printed(EXAMPLES / f"{name}.py", capsys)
    finally:
        plt.close("all")
    assert plt.imread(picture).std() > 0.02  # something is drawn
    return found


def arrived(found: list[float]) -> bool:
    return max(map(abs, found[:2])) > 100.0 and max(map(abs, found[3:5])) < 10.0


def bends_unseen(found: list[float]) -> bool:
    return found[::2] == [0.0, 50.0, 100.0] and found[1] + 5.0 < found[3] < found[5] - 5.0


def third_arm_moves(found: list[float]) -> bool:
    return found[0] == 50.0 and abs(found[1] - 50.0) < 3.0 and abs(found[2] - 50.0) < 3.0


def replays(found: list[float]) -> bool:
    return found[-2] > 20 and abs(found[-1] - 30.0) < 3.0


def believes_to_be_there(found: list[float]) -> bool:
    told_mm, true_mm, after_s = found
    return told_mm < 6.0 < true_mm < 60.0 and after_s < 20.0


EXAMPLE_CHECKS = {
    "own_calibration": arrived,
    "own_disturbance": bends_unseen,
    "own_arm": third_arm_moves,
    "replay_a_recording": replays,
    "own_controller": believes_to_be_there,
}


def test_the_notebook_runs_from_top_to_bottom() -> None:
    book = json.loads((ROOT / "examples" / "notebooks" / "first_run.ipynb").read_text(encoding="utf-8"))
    cells = ["".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "code"]
    names: dict[str, Any] = {}
    shown = [value_of(cell, names) for cell in cells]
    assert "outside ±5 mm" in repr(shown[1])
    assert "inside ±5 mm" in repr(names["after"])
    assert "<table>" in names["after"]._repr_html_()
    pictures = [figure for figure in shown if hasattr(figure, "savefig")]
    assert [figure._repr_png_()[:4] for figure in pictures] == 3 * [b"\x89PNG"]
    assert shown[-1] is True


def value_of(cell: str, names: dict[str, Any]) -> Any:
    """What a notebook shows of ``cell``: the value of its last line, where that is an expression."""
    *before, last = ast.parse(cell).body
    assert isinstance(last, ast.Expr)
    exec(compile(ast.Module(before, []), "notebook", "exec"), names)
    return eval(compile(ast.Expression(last.value), "notebook", "eval"), names)


def test_every_example_is_run_here() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(EXAMPLE_CHECKS)


ON_SOCKETS = {"own_controller"}


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.realtime if name in ON_SOCKETS else ()) for name in EXAMPLE_CHECKS],
)
def test_an_example_shows_what_it_says(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = shown(name, tmp_path / "picture.png", capsys, monkeypatch)
    assert EXAMPLE_CHECKS[name](found), found
