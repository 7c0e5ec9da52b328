"""Ctrl-C in every long command, as a terminal sends it: the status, how soon it ends, what it says is kept.

`make experiments ARGS="tests/testbed/cli/test_ctrl_c.py"` prints the table.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

pytestmark = [pytest.mark.experiment, pytest.mark.timeout(400)]

CPU_S = 6.0  # by then the modules are loaded and the work has begun; waiting commands never use so much
WAITED_S = 25.0
ENDED_WITHIN_S = 20.0


class Case(NamedTuple):
    """A command, with ``{made}`` for a recording and ``{out}`` for a directory, and what Ctrl-C does."""

    command: str
    kept: str = ""  # said on stderr
    status: int = 130


ROWS = "rows are kept in"
CASES = (
    Case("demo --free-ports --out {out}"),
    Case("demo --lockstep --out {out}"),
    Case("demo --lockstep --target hole --out {out}"),
    Case("up --free-ports --out {out}", status=0),  # Ctrl-C is how it is ended
    Case("soak --free-ports --minutes 5 --out {out}"),
    Case("experiment best-mode --count 5 --workers 0 --out {out}", ROWS),
    Case("experiment best-mode --count 5 --workers 2 --out {out}", ROWS),
    Case("experiment paper --eyes model --count 5 --workers 0 --out {out}", ROWS),
    Case("experiment attacks --out {out}", ROWS),
    Case("experiment settle --count 5 --workers 0 --out {out}", ROWS),
    Case("experiment commissioning --count 5 --workers 0 --out {out}", ROWS),
    Case("experiment targets --count 50 --workers 0 --out {out}", ROWS),
    Case("sensitivity --workers 0 --out {out}", ROWS),
    Case("commission --out {out}", "the same command goes on"),
    Case("identify {made}/moved.csv --out {out}/plant"),
    Case("camera emulate --pairs 400 --out {out}/board"),
    Case("hand-eye camera-share --count 100"),
    Case("validate plant"),
    Case("validate plant-survey --out {out}"),
    Case("picture effects --out {out}"),
    Case("picture run {out}/run.webp"),
    Case("proxy --listen-port 47091 --port 47092", status=0),  # as `up`
    Case("sniff --interface lo", status=0),  # as `up`
    Case("replay {made}/run/vision_pc/vision.mcap"),
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings: vision's, to be replayed, and an arm's motion, to be identified."""
    made = tmp_path_factory.mktemp("made")
    for command in ("demo --lockstep --out {}/runs", "identify {}/moved.csv --record"):
        subprocess.run([*LONGREACH, *command.format(made).split()], check=True, capture_output=True)
    (recording,) = made.glob("runs/*/**/vision.mcap")
    shutil.copytree(recording.parent.parent, made / "run")
    return made


@pytest.fixture(scope="module", autouse=True)
def table() -> Iterator[list[str]]:
    lines = ["", "| command | status | ended after s | said |", "| --- | --- | --- | --- |"]
    yield lines
    print("\n".join(lines))


LONGREACH = [sys.executable, "-m", "testbed.cli.main"]


def cpu_s(pid: int) -> float:
    """Processor time of a process and of its ended children."""
    with contextlib.suppress(FileNotFoundError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def interrupted(command: list[str]) -> tuple[int, float, str]:
    """Status, time to the end, stderr of a command whose process group gets SIGINT while it works."""
    child = subprocess.Popen(
        [*LONGREACH, *command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        began_s = time.monotonic()
        while cpu_s(child.pid) < CPU_S and time.monotonic() - began_s < WAITED_S:
            if child.poll() is not None:
                _, told = child.communicate()
                pytest.fail(f"ended by itself with {child.returncode}: {told}")
            time.sleep(0.1)
        asked_s = time.monotonic()
        os.killpg(child.pid, signal.SIGINT)
        _, told = child.communicate(timeout=60.0)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
    return child.returncode, time.monotonic() - asked_s, told


@pytest.mark.parametrize("case", CASES, ids=lambda case: " ".join(case.command.split()[:2]))
def test_it_ends_soon_and_says_what_is_kept(
    case: Case, tmp_path: Path, request: pytest.FixtureRequest, table: list[str]
) -> None:
    recording = str(request.getfixturevalue("made")) if "{made}" in case.command else ""
    command = [word.format(out=tmp_path, made=recording) for word in case.command.split()]
    status, took_s, told = interrupted(command)
    shown = case.command.partition(" --out")[0].replace("{out}/", "").replace("{made}/", "")
    said = "; ".join(line for line in told.splitlines() if "kept" in line or "Ctrl-C" in line)
    table.append(f"| `{shown}` | {status} | {took_s:.1f} | {said.replace(str(tmp_path), 'OUT')} |")
    assert "Traceback" not in told, told
    assert status == case.status, told
    assert case.kept in told
    assert took_s < ENDED_WITHIN_S
