"""Every command that a page or an example shows is understood."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from testbed.cli.main import app

pytestmark = pytest.mark.slow("new interpreters, one a command")

ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
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
