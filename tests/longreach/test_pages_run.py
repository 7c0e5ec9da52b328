"""README, tutorial and use from Python: every command is run as it stands, and prints what the page says."""

import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from tests.support.pages import page
from tests.support.paths import ROOT
from tools.printed import NUMBER, Block, agree, blocks, on_that_processor, output, renewed

pytestmark = [pytest.mark.slow("pages are run as they stand"), pytest.mark.timeout(900)]

TUTORIAL = page("tutorial.md")
TEXTS = (TUTORIAL, page("how_to/use_from_python.md"), (ROOT / "README.md").read_text(encoding="utf-8"))
ELSEWHERE = ("docker compose", "make test", "longreach up\n")  # `make compose-test`; what runs this; below
FREE = "ARGS=--free-ports"  # others use the usual ones
EVERY = [block for text in TEXTS for block in blocks(text) if block.language in ("sh", "python")]
LEFT_OUT = [block for block in EVERY if block.text.startswith(ELSEWHERE)]


def test_what_is_run_elsewhere_is_all_that_is_left_out() -> None:
    first = sorted(block.text.splitlines()[0] for block in LEFT_OUT)
    assert first == ["docker compose up --build --wait", "longreach up", "make test"]


def cases() -> list[object]:
    return [
        pytest.param(block, marks=[pytest.mark.processes] if "make demo" in block.text else [])
        for block in EVERY
        if block not in LEFT_OUT
    ]


@pytest.mark.parametrize("block", cases(), ids=lambda block: block.text.splitlines()[-1])
def test_a_block_prints_what_the_page_says(
    block: Block, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAKEFLAGS", FREE)
    try:
        said = output(block, ROOT if block.text.startswith("make") else tmp_path)
    except subprocess.CalledProcessError as failed:
        pytest.fail((failed.stdout + capfd.readouterr().err)[-2000:])
    for line in block.printed:
        now = renewed(line, said)
        if "make demo" in block.text:
            assert max(abs(float(number)) for number in NUMBER.findall(now)) <= 5.0, now
        else:
            assert agree(line, now, on_that_processor()), f"comes {now}; run: python -m tools.printed"


@pytest.mark.processes
def test_longreach_up_serves_the_page_until_ctrl_c(tmp_path: Path) -> None:
    assert "\nlongreach up\n" in TUTORIAL
    up = subprocess.Popen(
        [Path(sys.executable).parent / "longreach", "up", "--free-ports"],
        cwd=tmp_path, stdout=subprocess.PIPE, text=True,
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
