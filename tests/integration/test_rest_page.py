"""The block of rest.md, as it stands, against `longreach up`."""

import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.support.page_runner import API, judge_rest_block, pasted, shell_blocks
from tests.support.paths import CONFIGS
from tests.support.patience import PATIENT

# What is starved keeps its session, and its camera.
_OURS = ("controller.reference_link.link_timeout_ms=5000", "vision.camera.stale_ms=8000", *PATIENT)

pytestmark = [pytest.mark.realtime, pytest.mark.slow("a minute of motions"), pytest.mark.timeout(600)]


class Up(NamedTuple):
    """The address of a testbed that `longreach up` has started, and what it said since."""

    url: str
    said: list[str]


@pytest.fixture
def up(tmp_path: Path) -> Iterator[Up]:
    words = [sys.executable, "-u", "-m", "testbed.cli", "up", "--free-ports", "--config-dir", str(CONFIGS)]
    words += ["--out", str(tmp_path / "runs"), *(word for one in _OURS for word in ("--set", one))]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    said: list[str] = []
    try:
        began = next(line for line in process.stdout if "REST API" in line)
        reader = threading.Thread(target=said.extend, args=(process.stdout,))
        reader.start()
        yield Up(re.findall(r"http://127\.0\.0\.1:\d+", began)[0], said)
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=30.0)
        reader.join(10.0)
        process.stdout.close()


def test_the_block_of_the_page_works_against_up(up: Up, tmp_path: Path) -> None:
    (block,) = shell_blocks("rest.md")
    assert API in block
    nowhere = {"COMPOSE_FILE": str(tmp_path / "none.yml")}  # no containers: there is no token
    printed = pasted(block, up.url, tmp_path, nowhere, "docker compose", 500.0)
    try:
        judge_rest_block(printed, tmp_path)
    except AssertionError:
        # Legs of which few pictures came, a session or a camera that was starved: the testbed says so itself.
        for line in up.said:
            if "overloaded" in line:
                pytest.skip(f"this machine did not keep up with real time: {line.strip()}")
        raise
