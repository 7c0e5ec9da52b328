"""The block of rest.md, as it stands, against `longreach up`."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.support.page_runner import API, judge_rest_block, pasted, shell_blocks
from tests.support.paths import CONFIGS

_PATIENT = "controller.reference_link.link_timeout_ms=5000"  # a starved one keeps its session
_LATE = re.compile(r'"cause":"((?:link|fault|refused\.fault)[._]\w+)"')

pytestmark = [pytest.mark.realtime, pytest.mark.slow("a minute of motions"), pytest.mark.timeout(600)]


@pytest.fixture
def up(tmp_path: Path) -> Iterator[str]:
    """The address of a testbed that `longreach up` has started."""
    words = [sys.executable, "-u", "-m", "testbed.cli", "up", "--free-ports", "--config-dir", str(CONFIGS)]
    words += ["--out", str(tmp_path / "runs"), "--set", _PATIENT]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        said = next(line for line in process.stdout if "REST API" in line)
        yield re.findall(r"http://127\.0\.0\.1:\d+", said)[0]
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30.0)


def test_the_block_of_the_page_works_against_up(up: str, tmp_path: Path) -> None:
    (block,) = shell_blocks("rest.md")
    assert API in block
    nowhere = {"COMPOSE_FILE": str(tmp_path / "none.yml")}  # no containers: there is no token
    printed = pasted(block, up, tmp_path, nowhere, "docker compose", 500.0)
    overload = httpx.get(f"{up}/health").json()["overload"]
    if overload and (late := _LATE.search(printed)):
        pytest.skip(f"this machine did not keep up with real time: {late[1]}; {overload}")
    judge_rest_block(printed, tmp_path)
