"""A page's own commands, run as they stand, and what the page says that they print."""

import json
import os
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tests.support.pages import page

API = "http://127.0.0.1:8000"
_FENCED = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


class Block(NamedTuple):
    """A block in ``language`` (sh, python), and the lines that the page says it prints."""

    language: str
    text: str
    printed: tuple[str, ...]


def blocks(text: str) -> list[Block]:
    """The blocks of a page that can be run, in order, each with the ``text`` block behind it, if any."""
    found: list[Block] = []
    for language, inside in _FENCED.findall(text):
        if language == "text":
            assert found, f"nothing is run before {inside!r}"
            found[-1] = found[-1]._replace(printed=tuple(inside.splitlines()))
        else:
            found.append(Block(language, inside, ()))
    return found


def missing(printed: tuple[str, ...], output: str, tolerance: float) -> list[str]:
    """The lines of ``printed`` that ``output`` has nowhere: same words, numbers within ``tolerance``.

    A terminal breaks lines anywhere: blanks are compared as one.
    """
    said = " ".join(output.split())
    return [line for line in printed if not _is_in(" ".join(line.split()), said, tolerance)]


def _is_in(line: str, said: str, tolerance: float) -> bool:
    words = [re.escape(word) for word in _NUMBER.split(line)]
    expected = [float(number) for number in _NUMBER.findall(line)]
    pattern = re.compile(f"({_NUMBER.pattern})".join(words))
    return any(
        all(
            abs(float(is_) - should) <= tolerance
            for is_, should in zip(found.groups(), expected, strict=True)
        )
        for found in pattern.finditer(said)
    )


def shell_blocks(name: str) -> list[str]:
    """The shell blocks of docs/``name``, in their order."""
    return [block.text for block in blocks(page(name)) if block.language in ("", "sh")]


def pasted(
    block: str, api: str, into: Path, environment: Mapping[str, str], compose: str, within_s: float
) -> str:
    """What ``block`` prints, pasted in the folder ``into`` against ``api``, with this spelling of Compose."""
    text = block.replace(API, api).replace("docker compose", compose)
    done = subprocess.run(
        ["bash", "-c", text],
        cwd=into,
        env=os.environ | dict(environment),
        capture_output=True,
        text=True,
        timeout=within_s,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
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
        rf"x and y differ from this by at most ({_NUMBER.pattern}) mm, z by ({_NUMBER.pattern}) mm", text
    )
    limits = {"x": float(within_xy), "y": float(within_xy), "z": float(within_z)}
    off = {axis: look["error_mm"][axis] - shown[axis] for axis in limits}
    assert all(abs(off[axis]) <= limits[axis] for axis in limits), off
    assert f'"verdict":"{look["verdict"]}"' in text
    assert answers[5]["kind"] == "looking-and-moving"
    assert answers[6]["connected"] is True
