"""Rows of a campaign: one CSV file that is never left half written, and its columns as arrays.

A cell is empty (nothing, no text, or not a finite number), JSON, or text; text that would be taken for JSON,
or that holds a line break, is written as a JSON string.
"""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.reporting.console import plain

Row = dict[str, Any]

csv.field_size_limit(1 << 26)  # a cell may hold a list


def cell(value: Any) -> str:
    """``value`` as a cell."""
    value = plain(value)
    if value is None or value == "":
        return ""
    if isinstance(value, str) and "\n" not in value and "\r" not in value and _value(value) == value:
        return value
    return json.dumps(value, ensure_ascii=False)


def _value(text: str) -> Any:
    """What a cell says: the inverse of ``cell``."""
    try:
        return json.loads(text, parse_constant=str) if text else None
    except ValueError:
        return text


def read_rows(path: Path) -> list[Row]:
    """The rows in the file at ``path``, each with all columns; none where there is no file."""
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return [{name: _value(text) for name, text in row.items()} for row in csv.DictReader(file)]


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Put these rows in place of what is in the file, at once."""
    columns = dict.fromkeys(name for row in rows for name in row)
    beside = path.with_suffix(".part")
    with beside.open("w", encoding="utf-8", newline="") as file:
        lines = ([cell(row.get(name)) for name in columns] for row in rows)
        csv.writer(file, lineterminator="\n").writerows([list(columns), *lines])
    beside.replace(path)


def column(rows: Iterable[Mapping[str, Any]], name: str) -> NDArray[np.float64]:
    """The numbers (n,) of a column, NaN where a row has none."""
    values = [row.get(name) for row in rows]
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
