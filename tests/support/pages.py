"""The written pages, table by table."""

import itertools
import re
from typing import NamedTuple

from tests.support.paths import DOCS


def page(name: str) -> str:
    """The text of docs/``name``."""
    return (DOCS / name).read_text(encoding="utf-8")


def rows(text: str, first_columns: str) -> dict[str, list[str]]:
    """The table whose heading begins so: each row's first cell, bare, with its other cells."""
    _, _, after = text.partition(f"| {first_columns} |")
    table = after[after.index("\n") :].lstrip("\n").split("\n\n")[0].splitlines()[1:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    return {row[0].strip("`"): row[1:] for row in cells}


def commands_of(name: str, heading: str) -> list[str]:
    """The lines of the shell blocks behind ``heading`` of docs/``name``, up to the next heading."""
    _, _, after = page(name).partition(f"\n## {heading}")
    section = after.partition("\n## ")[0]
    return [line for block in section.split("```sh\n")[1:] for line in block.split("```")[0].splitlines()]


def table_below(text: str, heading: str) -> list[list[str]]:
    """The cells of the first table behind ``heading`` in ``text``, row by row, without its head."""
    lines = text[text.index(heading) :].splitlines()
    begin = next(i for i, line in enumerate(lines) if line.startswith("|---"))
    found = itertools.takewhile(lambda line: line.startswith("|"), lines[begin + 1 :])
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in found]


class SessionRow(NamedTuple):
    """In ``state``, after ``event``: the next state, and the datagrams that are sent ("–": none)."""

    state: str
    event: str
    then: str
    sends: str


def session_rows(name: str) -> list[SessionRow]:
    """The rows of a table of states of the written protocol."""
    cells = table_below(page("protocol.md"), f"<!-- table: {name} -->")
    return [SessionRow(state, event, then or state, sends or "–") for state, event, then, sends in cells]


def signed_datagrams() -> dict[str, bytes]:
    """The signed datagrams of the written protocol's annex, by the names of their messages."""
    listing = page("protocol.md").partition("<!-- table: signed golden -->")[2].split("```")[1]
    _, *parts = re.split(r"^([A-Z]\w+)$", listing, flags=re.MULTILINE)
    return {name: bytes.fromhex(data) for name, data in zip(parts[::2], parts[1::2], strict=True)}
