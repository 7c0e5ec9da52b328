"""One word for one thing in every command, and every command that a page shows is understood."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from click.testing import Result
from typer.testing import CliRunner

from testbed.cli.main import app

pytestmark = pytest.mark.slow("new interpreters, one a command")

ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
SAID_OTHERWISE = {"--runs", "--directory", "--output", "--outdir", "--drawn", "--n", "--number-of-runs"}
WITHOUT_FIGURES = {  # commands that print none, so that there is nothing for --json to write
    "up", "init", "token new", "arm new", "arm draw", "runs open",
    "camera convert", "camera emulate", "camera serve", "hand-eye drawing", "hand-eye session run",
    "hand-eye session export", "hand-eye samples",
}  # fmt: skip
_SHOWN = re.compile(r"longreach((?: +(?:'[^']*'|[^\s`|#()<>]+))+)")


def walked(command: Any, path: tuple[str, ...], context: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command below ``command`` that is no group, by its words."""
    names = command.list_commands(context) if hasattr(command, "list_commands") else []
    for name in names:
        yield from walked(command.resolve_command(context, [name])[1], (*path, name), context)
    if not names:
        yield path, command


@pytest.fixture(scope="module")
def commands() -> dict[str, Any]:
    root = typer.main.get_command(app)
    return {" ".join(path): command for path, command in walked(root, (), typer.Context(root))}


def options(command: Any) -> set[str]:
    return {name for parameter in command.params for name in parameter.opts if name.startswith("-")}


def asked(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


def test_one_word_for_one_thing(commands: dict[str, Any]) -> None:
    for path, command in commands.items():
        assert not options(command) & SAID_OTHERWISE, path
        assert path in WITHOUT_FIGURES or "--json" in options(command), path
        named = [getattr(p, "help", None) or "" for p in command.params if p.param_type_name == "argument"]
        assert not [told for told in named if "Where" in told or "to write" in told], (path, "wants --out")
    assert set(commands) >= WITHOUT_FIGURES
    several = {"experiment paper", "experiment positioning"}
    assert all({"--count", "--seed"} <= options(commands[path]) for path in several)


def _shown(text: str) -> Iterator[list[str]]:
    for found in _SHOWN.finditer(text.replace("\\\n", " ")):
        try:
            yield shlex.split(found[1])
        except ValueError:  # a quotation mark of the sentence around it
            continue


def _unknown(words: list[str], commands: dict[str, Any]) -> list[str]:
    """The options of a shown command that it would not understand; none where it is no command of ours."""
    path = next((n for n in (3, 2, 1) if " ".join(words[:n]) in commands), 0)
    known = options(commands[" ".join(words[:path])]) | {"--help"} if path else set()
    given = {
        word.partition("=")[0].strip("[],;.…") for word in words[path:] if word.startswith(("--", "[--"))
    }
    return sorted(name for name in given if path and name not in known)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_shows_is_understood(page: Path, commands: dict[str, Any]) -> None:
    for words in _shown(page.read_text(encoding="utf-8")):
        assert not _unknown(words, commands), words


def test_every_example_is_one(commands: dict[str, Any]) -> None:
    for path, command in commands.items():
        for words in _shown(command.epilog or ""):
            assert " ".join(words).startswith(path), path
            assert not _unknown(words, commands), words
