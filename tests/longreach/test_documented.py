"""README, how-to page and examples say what they do: all of them are run as they stand."""

import re
import runpy
from pathlib import Path

import pytest

from tests.support.pages import page
from tests.support.paths import ROOT

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

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


def test_every_example_is_run_here() -> None:
    assert sorted(path.name for path in EXAMPLES.glob("*.py")) == ["own_calibration.py", "own_disturbance.py"]


def test_a_calibration_of_ones_own_reaches_the_object(capsys: pytest.CaptureFixture[str]) -> None:
    found = printed(EXAMPLES / "own_calibration.py", capsys)
    assert max(map(abs, found[:2])) > 100.0
    assert max(map(abs, found[3:5])) < 10.0


def test_a_load_takes_the_tool_from_where_it_is_believed(capsys: pytest.CaptureFixture[str]) -> None:
    found = printed(EXAMPLES / "own_disturbance.py", capsys)
    assert found[::2] == [0.0, 50.0, 100.0]
    assert found[1] + 5.0 < found[3] < found[5] - 5.0
