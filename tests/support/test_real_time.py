"""The plugins of the suite, on projects of their own: order, second try and its limit, time by folder."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

CONFTEST = "pytest_plugins = ['tests.support.real_time', 'tests.support.time_spent']\n"
OPTIONS = "[pytest]\nmarkers =\n    realtime: x\n    slow: x\n"
FLAKY = """
import pathlib, pytest
TRIES = pathlib.Path(__file__).with_suffix(".tries")
{mark}
@pytest.mark.parametrize("which", range({count}))
def test_flaky(which):
    path = TRIES.with_suffix(f".{{which}}")
    tries = int(path.read_text()) + 1 if path.exists() else 1
    path.write_text(str(tries))
    assert tries > {wanted}, "too early"
"""
LEAKY = """
import pathlib, socket, threading, pytest
TRIES = pathlib.Path(__file__).with_suffix(".tries")
@pytest.mark.realtime
def test_leaky():
    first = not TRIES.exists()
    TRIES.write_text("1")
    if first:
        left_open = socket.socket()
        round_about = [left_open]
        round_about.append(round_about)
        thread = threading.Thread(target=lambda: 1 / 0)
        thread.start()
        thread.join()
        assert False, "too early"
"""
PASSES = "import pytest\n{mark}\ndef test_it(): print('{what}')\n"
MARKED = "@pytest.mark.realtime"
PLUGINS = ("-p", "no:cacheprovider", "-p", "xdist", "-p", "pytest_rerunfailures", "--rerun-show-tracebacks")
DISTRIBUTED = ("-n", "2", "--dist", "loadfile", "--no-loadscope-reorder")


def run(folder: Path, *arguments: str, **files: str) -> tuple[int, list[str]]:
    """The exit status and the lines of a run of pytest on ``files``."""
    for name, text in {"conftest": CONFTEST, **files}.items():
        (folder / f"{name}.py").write_text(text)
    (folder / "pytest.ini").write_text(OPTIONS)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    for name in ("PYTEST_ADDOPTS", "PYTEST_XDIST_WORKER", "PYTEST_XDIST_WORKER_COUNT"):
        environment.pop(name, None)
    environment["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    command = [sys.executable, "-m", "pytest", *PLUGINS, *arguments]
    ended = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=90)
    return ended.returncode, ended.stdout.splitlines()


@pytest.mark.parametrize(("processes", "retried", "failed"), [((), 3, 0), (DISTRIBUTED, 4, 1)])
def test_tests_in_real_time_are_retried_once_and_named_and_more_than_three_fail_a_run(
    processes: tuple[str, ...], retried: int, failed: int, tmp_path: Path
) -> None:
    status, lines = run(tmp_path, *processes, test_it=FLAKY.format(mark=MARKED, count=retried, wanted=1))
    assert f"{retried} passed, {retried} rerun" in lines[-1]
    assert any(f"{retried} retried, at most 3 may be: test_it.py::test_flaky[0], " in line for line in lines)
    assert any("too early" in line for line in lines), "what failed is printed"
    assert status == failed


def test_what_the_first_try_left_open_is_not_the_second_ones_fault(tmp_path: Path) -> None:
    status, lines = run(tmp_path, "-W", "error", test_it=LEAKY)
    assert status == 0, lines
    assert "1 passed, 2 rerun" in lines[-1], "the call and, as the thread failed, what follows it"
    assert any("1 retried" in line for line in lines)


def test_what_fails_twice_has_failed(tmp_path: Path) -> None:
    status, lines = run(tmp_path, test_it=FLAKY.format(mark=MARKED, count=1, wanted=2))
    assert status == 1
    assert "1 failed, 1 rerun" in lines[-1]
    assert (tmp_path / "test_it.0").read_text() == "2"


def test_a_test_without_the_mark_is_never_retried(tmp_path: Path) -> None:
    status, lines = run(tmp_path, test_it=FLAKY.format(mark="", count=1, wanted=1))
    assert status == 1
    assert "1 failed" in lines[-1]
    assert "rerun" not in lines[-1]
    assert (tmp_path / "test_it.0").read_text() == "1"


def test_what_is_slow_is_begun_first_and_real_time_last(tmp_path: Path) -> None:
    kinds = ("realtime", "plain", "slow")
    marks = (MARKED, "", "@pytest.mark.slow('x')")
    files = {
        f"test_{i}": PASSES.format(mark=mark, what=kind)
        for i, (kind, mark) in enumerate(zip(kinds, marks, strict=True))
    }
    status, lines = run(tmp_path, *DISTRIBUTED, "-n", "1", "-rP", **files)
    assert status == 0
    assert [line for line in lines if line in kinds] == ["slow", "plain", "realtime"]
