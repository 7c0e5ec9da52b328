"""The plugin of the real-time tests, on projects of its own: order, second try, count, exit status."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

CONFTEST = "pytest_plugins = ['tests.support.real_time']\n"
OPTIONS = "[pytest]\nmarkers =\n    realtime: x\n    long: x\n"
ORDERED = """
import os, time, pathlib, pytest
HERE = pathlib.Path(__file__).parent
def note(kind):
    with open(HERE / "notes", "a") as notes:
        print(kind, os.getpid(), time.monotonic(), file=notes)
@pytest.mark.realtime("processes")
@pytest.mark.parametrize("i", range(3))
def test_service(i):
    note("begin"); time.sleep(0.02); note("end")
@pytest.mark.realtime
@pytest.mark.parametrize("i", range(3))
def test_socket(i):
    note("socket")
@pytest.mark.parametrize("i", range(6))
def test_pure(i):
    time.sleep(0.05); note("pure")
"""
FLAKY = """
import pathlib, pytest
TRIES = pathlib.Path(__file__).with_suffix(".tries")
@pytest.fixture(scope="module")
def tries():
    count = int(TRIES.read_text()) + 1 if TRIES.exists() else 1
    TRIES.write_text(str(count))
    return count
{mark}
def test_flaky(tries):
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
MARKED = "@pytest.mark.realtime"


def run(folder: Path, *arguments: str, **files: str) -> tuple[int, list[str]]:
    """The exit status and the lines of a run of pytest on ``files``."""
    for name, text in {"conftest": CONFTEST, **files}.items():
        (folder / f"{name}.py").write_text(text)
    (folder / "pytest.ini").write_text(OPTIONS)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    for name in ("PYTEST_ADDOPTS", "PYTEST_XDIST_WORKER", "PYTEST_XDIST_WORKER_COUNT"):
        environment.pop(name, None)
    environment["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "xdist", *arguments]
    ended = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=90)
    return ended.returncode, ended.stdout.splitlines()


@pytest.mark.parametrize("processes", [(), ("-n", "2")], ids=["one", "two"])
def test_a_real_time_test_is_retried_once_with_new_fixtures_and_counted(
    processes: tuple[str, ...], tmp_path: Path
) -> None:
    status, lines = run(tmp_path, *processes, test_it=FLAKY.format(mark=MARKED, wanted=1))
    assert status == 0
    assert "1 passed, 1 retried" in lines[-1]
    assert any("1 retried: test_it.py::test_flaky" in line for line in lines)
    assert any("too early" in line for line in lines), "what failed is printed"


def test_what_the_first_try_left_open_is_not_the_second_ones_fault(tmp_path: Path) -> None:
    status, lines = run(tmp_path, "-W", "error", test_it=LEAKY)
    assert status == 0, lines
    assert "1 passed, 1 retried" in lines[-1]


def test_what_fails_twice_has_failed(tmp_path: Path) -> None:
    status, lines = run(tmp_path, test_it=FLAKY.format(mark=MARKED, wanted=2))
    assert status == 1
    assert "1 failed, 1 retried" in lines[-1]
    assert (tmp_path / "test_it.tries").read_text() == "2"


def test_a_test_without_the_mark_is_never_retried(tmp_path: Path) -> None:
    status, lines = run(tmp_path, test_it=FLAKY.format(mark="", wanted=1))
    assert status == 1
    assert "1 failed" in lines[-1]
    assert "retried" not in lines[-1]
    assert (tmp_path / "test_it.tries").read_text() == "1"


def test_real_time_tests_run_after_all_others_and_those_with_services_one_at_a_time(tmp_path: Path) -> None:
    status, lines = run(tmp_path, "-n", "2", test_a=ORDERED, test_b=ORDERED, test_c=ORDERED)
    assert status == 0
    assert "36 passed" in lines[-1]
    notes = [line.split() for line in (tmp_path / "notes").read_text().splitlines()]
    notes.sort(key=lambda note: float(note[2]))
    assert len({process for kind, process, _ in notes if kind == "pure"}) == 2
    services = [(kind, process) for kind, process, _ in notes if kind in ("begin", "end")]
    assert [kind for kind, _ in services] == ["begin", "end"] * 9
    assert len({process for _, process in services}) == 1
    # Each process keeps two tests until it knows what comes next: they may end beside the first real ones.
    first = next(index for index, (kind, _, _) in enumerate(notes) if kind != "pure")
    assert first >= 18 - 4


def test_what_is_long_is_begun_first(tmp_path: Path) -> None:
    long = "import pytest\n@pytest.mark.long\ndef test_long(): print('long')\n"
    short = "def test_a(): print('short')\ndef test_b(): print('short')\n"
    status, lines = run(tmp_path, "-n", "1", "-rP", test_a=short, test_b=short, test_c=long)
    assert status == 0
    assert [line for line in lines if line in ("long", "short")] == ["long", *["short"] * 4]


def test_only_real_time_tests_run_too(tmp_path: Path) -> None:
    status, lines = run(tmp_path, "-n", "2", "-m", "realtime", test_a=ORDERED, test_b=ORDERED)
    assert status == 0
    assert "12 passed" in lines[-1]
