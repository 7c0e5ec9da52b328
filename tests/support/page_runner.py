"""A page's own commands for running services, pasted as they stand, and what they answer."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.support.pages import page
from tests.support.paths import CONFIGS
from tools.printed import NUMBER, blocks

API = "http://127.0.0.1:8000"


def shell_blocks(name: str) -> list[str]:
    """The shell blocks of docs/``name``, in their order."""
    return [block.text for block in blocks(page(name)) if block.language in ("", "sh")]


@contextmanager
def up(folder: Path, *options: str) -> Iterator[tuple[str, str]]:
    """The addresses, REST and faults, of a testbed that `longreach up` has started."""
    words = [sys.executable, "-u", "-m", "longreach", "up", "--free-ports", "--config-dir", str(CONFIGS)]
    words += ["--pace", "0", "--allow-faults", *options, "--out", str(folder / "runs")]
    process = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    reader = threading.Thread(target=process.stdout.read)
    try:
        found: dict[str, str] = {}
        while "REST API" not in found:
            found |= dict(re.findall(r"([\w ]+): (http://127\.0\.0\.1:\d+)", next(process.stdout)))
        reader.start()
        yield found["REST API"], found["faults"]
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=30.0)
        reader.join(10.0)
        process.stdout.close()


def pasted(
    block: str, api: str, into: Path, environment: Mapping[str, str], compose: str, within_s: float
) -> str:
    """What ``block`` prints, pasted in the folder ``into`` against ``api``, with this spelling of Compose."""
    text = block.replace(API, api).replace("docker compose", compose)
    done = subprocess.run(
        ["bash", "-c", text],
        cwd=into,
        env=os.environ | dict(environment),
        stdout=subprocess.PIPE,  # what goes to stderr is shown by pytest where the test fails
        text=True,
        timeout=within_s,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def documents(printed: str) -> list[dict[str, Any]]:
    """The JSON documents of a block's output, a line each; other lines are left out."""
    return [json.loads(line) for line in printed.splitlines() if line.startswith("{")]


def refusals(answers: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The problem documents, and operations that did not succeed."""
    return [each for each in answers if "cause" in each or each.get("state", "succeeded") != "succeeded"]


def judge_rest_block(printed: str, into: Path) -> None:
    """Every line of the block of rest.md has done what it is for, and the page's figures hold."""
    answers = documents(printed)
    assert len(answers) == 8, printed
    failed = refusals(answers)
    assert not failed, failed
    look = answers[4]
    assert (into / "latest.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    text = page("rest.md")
    shown = json.loads("{" + re.findall(r'`("error_mm":\{[^`]*\})`', text)[0] + "}")["error_mm"]
    ((within_xy, within_z),) = re.findall(
        rf"x and y differ from this by at most ({NUMBER.pattern}) mm, z by ({NUMBER.pattern}) mm", text
    )
    limits = {"x": float(within_xy), "y": float(within_xy), "z": float(within_z)}
    off = {axis: look["error_mm"][axis] - shown[axis] for axis in limits}
    assert all(abs(off[axis]) <= limits[axis] for axis in limits), off
    assert f'"verdict":"{look["verdict"]}"' in text
    assert answers[5]["kind"] == "looking-and-moving"
    assert answers[6]["connected"] is True
