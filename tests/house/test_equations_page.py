"""docs/equations.md against the code: every function exists and names its equation's number."""

import importlib
import inspect
import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "equations.md"
_BELOW = {"Hua": "vision_pc/core/hand_eye/"}
_ROW = re.compile(r"^\| \((\d+)\)(?: to \((\d+)\))? \| [^|]+ \| `([^`]+)` \| ([^|]+) \|$")


class Row(NamedTuple):
    """One equation of the page, or several that one function holds."""

    paper: str
    first: int
    last: int
    file: str
    function: str


def _rows() -> list[Row]:
    rows, paper = [], ""
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            paper = line.split()[1]
        match = _ROW.match(line)
        if match is None:
            continue
        first, last, file, functions = match.groups()
        where = file if "_pc/" in file or paper == "Mäkinen" else _BELOW[paper] + file
        names = re.findall(r"`([^`]+)`", functions)
        rows += [Row(paper, int(first), int(last or first), where, name) for name in names]
    return rows


def _numbers(text: str) -> set[int]:
    """Every number that ``text`` names: (7), eq. 26, (9)-(16), (17) to (24)."""
    named = {int(n) for n in re.findall(r"\((\d{1,2})\)", text)}
    named |= {int(n) for n in re.findall(r"eq\. (\d{1,2})\b", text)}
    for a, b in re.findall(r"\((\d{1,2})\)(?:-| to )\((\d{1,2})\)", text):
        named |= set(range(int(a), int(b) + 1))
    return named


def test_the_function_of_each_equation_exists_and_names_its_number() -> None:
    missing = {}
    for row in _rows():
        found = importlib.import_module(row.file.removesuffix(".py").replace("/", "."))
        for part in row.function.split("."):
            found = getattr(found, part)
        source = inspect.getsource(getattr(found, "py_func", found))
        missing[row] = set(range(row.first, row.last + 1)) - _numbers(source)
    assert [(row, numbers) for row, numbers in missing.items() if numbers] == []
    assert len(missing) > 25


def test_every_equation_of_the_positioning_paper_has_a_row() -> None:
    named = {n for row in _rows() if row.paper == "Mäkinen" for n in range(row.first, row.last + 1)}
    assert named == set(range(1, 26))
