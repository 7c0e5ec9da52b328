"""README, notebook and examples say what they do: all of them are run as they stand."""

import re
import runpy
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from tests.support.paths import ROOT
from tools import printed

pytestmark = [pytest.mark.slow("examples run as they stand"), pytest.mark.timeout(600)]

README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = ROOT / "examples" / "python"


@pytest.fixture(autouse=True)
def in_the_repository(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def numbers(said: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", said)]


def test_the_readme_measures_what_is_true(tmp_path: Path) -> None:
    (block,) = [block for block in printed.blocks(README) if block.language == "python"]
    measured, true = (lambda n: (n[:3], n[3:]))(numbers(printed.output(block, tmp_path)))
    assert len(measured) == len(true) == 3
    assert measured == pytest.approx(true, abs=5.0)  # mm
    assert max(map(abs, true)) > 100.0


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


def test_the_notebook_shows_what_a_run_from_top_to_bottom_makes() -> None:
    assert printed.stale_cells() == []


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
    monkeypatch.setattr(sys, "argv", [name, str(tmp_path / "picture.png")])
    monkeypatch.setenv("MPLBACKEND", "Agg")
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    plt.close("all")
    assert plt.imread(tmp_path / "picture.png").std() > 0.02  # something is drawn
    found = numbers(capsys.readouterr().out)
    assert EXAMPLE_CHECKS[name](found), found
