"""README and tutorial: every command is run as it stands, and prints what the page says."""

import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from tests.support.page_runner import Block, blocks, missing
from tests.support.pages import page
from tests.support.paths import ROOT

pytestmark = [pytest.mark.slow("pages are run as they stand"), pytest.mark.timeout(900)]

TUTORIAL = page("tutorial.md")
README = (ROOT / "README.md").read_text(encoding="utf-8")
ELSEWHERE = ("docker compose", "make test")  # `make compose-test`; what runs this
WITHIN = {TUTORIAL: 1.0, README: 5.0}
FREE = {"MAKEFLAGS": "ARGS=--free-ports"}  # others use the usual ones


def environment() -> dict[str, str]:
    """Where `longreach` is this one; pages set no more than that."""
    return os.environ | FREE | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def runnable(text: str) -> list[Block]:
    return [block for block in blocks(text) if block.language in ("sh", "python") and not left_out(block)]


def left_out(block: Block) -> bool:
    return block.text.startswith(ELSEWHERE) or block.text == "longreach up\n"


def test_what_is_run_elsewhere_is_all_that_is_left_out() -> None:
    outside = [block.text.splitlines()[0] for text in WITHIN for block in blocks(text) if left_out(block)]
    assert sorted(outside) == ["docker compose up --build --wait", "longreach up", "make test"]


def cases() -> list[object]:
    return [
        pytest.param(
            text,
            block,
            id=block.text.splitlines()[0] + str(number),
            marks=[pytest.mark.realtime] if "make demo" in block.text else [],
        )
        for text in WITHIN
        for number, block in enumerate(runnable(text))
    ]


@pytest.mark.parametrize(("text", "block"), cases())
def test_a_block_prints_what_the_page_says(text: str, block: Block, tmp_path: Path) -> None:
    shell = ["bash", "-euo", "pipefail", "-c"] if block.language == "sh" else [sys.executable, "-c"]
    done = subprocess.run(
        [*shell, block.text],
        cwd=ROOT if block.text.startswith("make") else tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=800,
    )
    if done.returncode and (late := re.search(r".*machine is overloaded.*", done.stdout + done.stderr)):
        pytest.skip(f"the testbed says so itself: {late[0].strip()}")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert missing(block.printed, done.stdout, WITHIN[text]) == [], done.stdout[-2000:]


@pytest.mark.realtime
def test_longreach_up_serves_the_page_until_ctrl_c(tmp_path: Path) -> None:
    assert "\nlongreach up\n" in TUTORIAL
    up = subprocess.Popen(
        [Path(sys.executable).parent / "longreach", "up", "--free-ports"],
        cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert up.stdout is not None
        url = next(found[0] for line in up.stdout if (found := re.search(r"http://127.0.0.1:\d+/", line)))
        deadline = time.monotonic() + 60.0
        while b"Longreach console" not in (body := urllib.request.urlopen(url, timeout=10.0).read()):
            assert time.monotonic() < deadline, body[:200]
    finally:
        up.send_signal(signal.SIGINT)
        up.communicate(timeout=60.0)
    assert up.returncode in (0, 130)
