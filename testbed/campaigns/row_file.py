"""Rows of a campaign in one CSV file that is never left half written: readable by any tool, typed on return.

A cell is empty (nothing, no text, or not a finite number), ``true``, ``false``, a number, or text; text that
would be taken for another kind, or that holds a line break, is written as a JSON string.
"""

import csv
import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from testbed.reporting.console import plain

Row = dict[str, Any]

csv.field_size_limit(1 << 26)  # a cell may hold a list


def cell(value: Any) -> str:
    """``value`` as a cell."""
    value = plain(value)
    if value is None or value == "":
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return value if "\n" not in value and "\r" not in value and _value(value) == value else _json(value)
    return _json(value)


def _value(text: str) -> Any:
    """What a cell says: the inverse of ``cell``."""
    if text == "":
        return None
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            number = kind(text)
        except ValueError:
            continue
        return number if math.isfinite(number) else text
    if text[0] in '"[{':
        try:
            return json.loads(text)
        except ValueError:
            return text
    return text


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


class RowFile:
    """The rows in the file at ``path``; what an interrupted writer left of a last line is cut off."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.columns: list[str] = []
        self.rows: list[Row] = []
        if path.is_file():
            whole, _, torn = path.read_bytes().rpartition(b"\n")
            if torn:
                path.write_bytes(whole + b"\n" if whole else b"")
            self._read(whole.decode("utf-8"))

    def _read(self, text: str) -> None:
        reader = csv.DictReader(io.StringIO(text))
        self.columns = list(reader.fieldnames or [])
        self.rows = [{name: _value(entry) for name, entry in row.items()} for row in reader]

    def append(self, row: Mapping[str, Any]) -> Row:
        """The row as it will be read back; it is in the file, new columns at its end."""
        kept = {name: _value(cell(value)) for name, value in row.items()}
        new = [name for name in kept if name not in self.columns]
        self.rows.append(kept)
        self.columns += new
        if new:
            self._rewrite()
        else:
            with self.path.open("a", encoding="utf-8", newline="") as file:
                file.write(self._line([cell(kept.get(name)) for name in self.columns]))
        return kept

    def _rewrite(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        beside = self.path.with_suffix(".part")
        with beside.open("w", encoding="utf-8", newline="") as file:
            file.write(self._line(self.columns))
            file.writelines(self._line([cell(row.get(name)) for name in self.columns]) for row in self.rows)
        beside.replace(self.path)

    @staticmethod
    def _line(cells: list[str]) -> str:
        line = io.StringIO()
        csv.writer(line, lineterminator="\n").writerow(cells)
        return line.getvalue()
