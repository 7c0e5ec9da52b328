"""The written pages, table by table."""

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
