"""Ctrl-C in every long command, as a terminal sends it: the status, how soon it ends, what it says is kept.

`make experiments ARGS="tests/testbed/cli/test_ctrl_c.py"` prints the table.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer

from testbed.cli.main import app
from testbed.reporting.console import LONG, long_command, nothing_half_made, table_rows
from tests.support.pages import page

CPU_S = 6.0  # by then the modules are loaded and the work has begun; waiting commands never use so much
WAITED_S = 25.0
ENDED_WITHIN_S = 20.0


class Case(NamedTuple):
    """A command, with ``{made}`` for a recorded run and ``{out}`` for a directory, and words told of it."""

    command: str
    kept: str = ""


ROWS, RUN = "rows are kept in", "what was recorded is kept in"
CASES = (
    Case("demo --free-ports --out {out}", RUN),
    Case("demo --lockstep --out {out}"),
    Case("demo --lockstep --target hole --out {out}"),
    Case("up --free-ports --out {out}"),
    Case("soak --free-ports --minutes 5 --out {out}", RUN),
    Case("experiment positioning --count 5 --workers 0 --out {out}", ROWS),
    Case("experiment positioning --count 5 --workers 2 --out {out}", ROWS),
    Case("experiment paper --eyes model --count 5 --workers 0 --out {out}", ROWS),
    Case("experiment robustness --method attacks --out {out}", ROWS),
    Case("experiment parking --count 5 --workers 0 --out {out}", ROWS),
    Case("experiment commissioning --count 5 --workers 0 --out {out}", ROWS),
    Case("experiment targets --count 50 --workers 0 --out {out}", ROWS),
    Case("experiment sensitivity --workers 0 --out {out}", ROWS),
    Case("commission --out {out}", "joints are kept in"),
    Case("identify {made}/moved.csv --out {out}/plant"),
    Case("camera emulate --pairs 400 --out {out}/board"),
    Case("picture effects --out {out}"),
    Case("picture run --out {out}/run.webp"),
    Case("recording merge {made} --out {out}/merged.mcap"),
    Case("replay {made}/vision_pc/vision.mcap"),
    Case("proxy --listen-port 47091 --port 47092"),
    Case("sniff --interface lo"),
)
NOT_TRIED = {  # of the long commands
    "camera calibrate": "computes in one thread",
    "conformance": "waits for somebody else's controller",
    "hand-eye session run": "waits for a rig",
    "odometry": "wants a recorded sequence",
}


SHORT = {
    "arm check", "arm draw", "arm list", "arm new", "camera check", "camera convert", "doctor",
    "export mjcf", "export urdf", "hand-eye compare", "hand-eye drawing",
    "hand-eye intrinsics", "hand-eye samples", "hand-eye solve", "init", "markers", "picture machine",
    "programs", "runs clean", "runs compare", "runs list", "runs open", "runs show", "target", "token new",
    *(f"hand-eye session {step}" for step in (
        "back", "export", "go", "list", "locate", "next", "propose", "redo", "remove", "resume", "sample",
        "solve", "start",
    )),
}  # fmt: skip


def words(case: Case) -> list[str]:
    return case.command.split()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run, an arm's motion to be identified, and the file of a camera."""
    made = tmp_path_factory.mktemp("made")
    for command in (
        "demo --lockstep --out {}/runs",
        "identify {}/moved.csv --record",
        "camera emulate --pairs 20 --columns 9 --rows 6 --square-mm 60 --out {}/boards",
        "camera calibrate {}/boards --columns 9 --rows 6 --square-mm 60 --out {}/camera.yaml",
    ):
        subprocess.run([*LONGREACH, *command.format(made, made).split()], check=True, capture_output=True)
    (run,) = (path for path in (made / "runs").iterdir() if path.is_dir())
    for part in run.iterdir():
        part.rename(made / part.name)
    return made


@pytest.fixture(scope="module")
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


def ended(command: list[str]) -> tuple[int, float, str]:
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


@pytest.mark.experiment
@pytest.mark.timeout(400)
@pytest.mark.parametrize("case", CASES, ids=lambda case: " ".join(words(case)[:2]))
def test_it_ends_soon_and_says_what_is_kept(
    case: Case, tmp_path: Path, request: pytest.FixtureRequest, table: list[str]
) -> None:
    left = LONG[str(long_command(words(case)))]
    recording = str(request.getfixturevalue("made")) if "{made}" in case.command else ""
    status, took_s, told = ended([word.format(out=tmp_path, made=recording) for word in words(case)])
    shown = case.command.partition(" --out")[0].replace("{out}/", "").replace("{made}/", "")
    said = "; ".join(line for line in told.splitlines() if "kept" in line or "Ctrl-C" in line)
    table.append(f"| `{shown}` | {status} | {took_s:.1f} | {said.replace(str(tmp_path), 'OUT')} |")
    assert "Traceback" not in told, told
    assert status == left.status, told
    assert case.kept in told
    assert left.status == 0 or f"ended by Ctrl-C; run again, it {left.again}" in told
    assert took_s < ENDED_WITHIN_S


def test_every_long_command_is_tried_or_said_not_to_be() -> None:
    assert {long_command(words(case)) for case in CASES} | set(NOT_TRIED) == set(LONG)


def leaves(group: Any, before: tuple[str, ...] = ()) -> Iterator[str]:
    for name in group.list_commands(None):
        at = (*before, name)
        later = name in getattr(group, "later", {})
        inner = group.load(name) if later and name != "experiment" else group.get_command(None, name)
        if hasattr(inner, "list_commands"):
            yield from leaves(inner, at)
        else:
            yield " ".join(at)


def test_every_command_is_long_or_known_to_be_short() -> None:
    every = set(leaves(typer.main.get_command(app)))
    assert len(every) > 50
    assert {name for name in every if long_command(name.split()) is None} == SHORT


def test_the_page_has_the_table() -> None:
    assert "\n".join([*table_rows()]) + "\n\n" in page("commands.md")


def test_what_is_half_made_goes_and_what_was_there_stays(tmp_path: Path) -> None:
    made, there = tmp_path / "made", tmp_path / "there"
    there.write_text("of somebody else")
    for target in (made, there):
        with pytest.raises(KeyboardInterrupt), nothing_half_made(target):  # noqa: PT012  the end raises
            target.write_text("half")
            raise KeyboardInterrupt
    assert not made.exists()
    assert there.exists()
