"""How commands end that cannot go on: one line and a status, no traceback, nothing half made left behind."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.commands import ran

pytestmark = pytest.mark.slow("new interpreters, one a command")

LONGREACH = [sys.executable, "-m", "testbed.cli.main"]


@pytest.mark.parametrize("step", [("run", "monday"), ("list",), ("remove", "3")])
def test_a_session_without_a_rig_says_what_to_start(step: tuple[str, ...]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as nobody:  # bound, never listening
        nobody.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{nobody.getsockname()[1]}"
        done = ran("hand-eye", "session", *step, "--url", url, status=2)
    assert "longreach: link.rest: " in done.stderr
    assert "`longreach up` starts" in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ("demo", "--lockstep", "--out", "{file}/runs"),
        ("up", "--free-ports", "--out", "{file}/runs"),
        ("experiment", "positioning", "--count", "1", "--out", "{file}/rows"),
        ("arm", "list", "--json", "{file}/arms.json"),
    ],
)
def test_a_folder_that_cannot_be_written_is_said_before_the_work(
    arguments: tuple[str, ...], tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.write_text("not a directory")
    began_s = time.process_time()
    done = ran(*(argument.format(file=file) for argument in arguments), status=2)
    assert "longreach: " in done.stderr
    assert str(file) in done.stderr
    assert time.process_time() - began_s < 30.0


def starts_workers(process: int) -> bool:
    """Whether ``process`` has begun the first of its workers."""
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # threads and processes come and go
        for thread in Path(f"/proc/{process}/task").glob("*/children"):
            for child in thread.read_text().split():
                if b"multiprocessing" in Path(f"/proc/{child}/cmdline").read_bytes():
                    return True
    return False


def interrupted(*arguments: str, after: Path | Callable[[int], bool]) -> tuple[int, str]:
    """Status and stderr of a command that gets Ctrl-C, as all its processes do, once ``after`` is there."""
    child = subprocess.Popen(
        [*LONGREACH, *arguments], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        deadline_s = time.monotonic() + 240.0  # a start on a busy machine
        while not (after(child.pid) if callable(after) else list(after.parent.glob(after.name))):
            assert child.poll() is None, child.communicate()
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        os.killpg(child.pid, signal.SIGINT)
        _, told = child.communicate(timeout=60.0)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.communicate()
    assert "Traceback" not in told
    return child.returncode, told


@pytest.mark.timeout(400)
def test_ctrl_c_in_lockstep_leaves_no_empty_directory(tmp_path: Path) -> None:
    status, told = interrupted(
        "demo", "--lockstep", "--out", str(tmp_path / "runs"), after=tmp_path / "runs" / "*"
    )
    assert status == 130
    assert told.strip() == "longreach: ended by Ctrl-C"
    assert not (tmp_path / "runs").exists()


@pytest.mark.timeout(400)
def test_ctrl_c_in_a_campaign_keeps_the_rows_and_says_so(tmp_path: Path) -> None:
    status, told = interrupted(
        *("experiment", "hua", "--method", "stress", "--count", "20000", "--out", str(tmp_path)),
        after=tmp_path / "rows.csv",
    )
    assert status == 130
    assert f"rows are kept in {tmp_path}/rows.csv" in told
    assert "longreach: ended by Ctrl-C" in told


@pytest.mark.timeout(400)
def test_ctrl_c_while_workers_start_is_not_lost(tmp_path: Path) -> None:
    status, told = interrupted(
        *("experiment", "hua", "--method", "stress", "--count", "20000", "--out", str(tmp_path)),
        after=starts_workers,
    )
    assert status == 130
    assert "longreach: ended by Ctrl-C" in told


@pytest.mark.parametrize("command", [("up",), ("demo",)])
def test_a_taken_port_is_named_before_anything_starts(command: tuple[str, ...], tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        port = holder.getsockname()[1]
        runs = tmp_path / "runs"
        done = ran(*command, "--out", runs, "--set", f"vision.api.port={port}", status=2)
    assert f"rest port vision.api.port = 127.0.0.1:{port}: Address already in use" in done.stderr
    assert f"held by process {os.getpid()} (" in done.stderr
    assert "--free-ports" in done.stderr
    assert not runs.exists()
