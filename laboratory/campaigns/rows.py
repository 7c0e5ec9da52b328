"""Rows of a campaign: one CSV file that is never left half written, and the same rows as types.

A cell is empty (nothing, no text, or not a finite number), ``true``, ``false``, a number, or text; text that
would be taken for another kind, or that holds a line break, is written as a JSON string.

A type is a NamedTuple an experiment, its columns named after its fields. A field that is a NamedTuple itself
gives its name to its columns (``look1`` with ``steps``: ``look1_steps``), one that is an ``XYZ`` is three
columns with the axis before the unit (``true_mm``: ``true_x_mm`` …).
"""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_type_hints

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
            self._read_rows(whole.decode("utf-8"))

    def _read_rows(self, text: str) -> None:
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


R = TypeVar("R")


class XYZ(NamedTuple):
    """Three components of one quantity."""

    x: float
    y: float
    z: float


UNKNOWN = XYZ(math.nan, math.nan, math.nan)


def xyz(vector: Sequence[float] | NDArray[np.float64]) -> XYZ:
    """The components of a vector (3,)."""
    x, y, z = (float(value) for value in vector)
    return XYZ(x, y, z)


def flat(row: Any) -> Row:
    """The columns of a typed row, or of a mapping with typed rows in it."""
    made: Row = {}
    for name, value in (row if isinstance(row, Mapping) else row._asdict()).items():
        if isinstance(value, XYZ):
            made |= zip(_columns(name), value, strict=True)
        elif hasattr(value, "_asdict"):
            made |= {f"{name}_{inner}": cell for inner, cell in flat(value).items()}
        else:
            made[name] = value
    return made


def typed(kind: type[R], row: Row, prefix: str = "") -> R:
    """The row as ``kind``; what it lacks is NaN, no text, False or None. A ``dict`` is the row as it is."""
    if kind is dict:
        return row  # type: ignore[return-value]
    return kind(**{name: _typed_value(hint, f"{prefix}{name}", row) for name, hint in _hints(kind).items()})


def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def _columns(name: str) -> list[str]:
    stem, _, unit = name.rpartition("_")
    return [f"{stem}_{axis}_{unit}" for axis in "xyz"]


def _typed_value(hint: Any, name: str, row: Row) -> Any:
    if hint is XYZ:
        return XYZ(*(_typed_value(float, column, row) for column in _columns(name)))
    if hasattr(hint, "_fields"):
        return typed(hint, row, f"{name}_")
    value = row.get(name)
    if hint is float:
        return math.nan if value is None else float(value)
    if hint is str:
        return "" if value is None else str(value)
    return bool(value) if hint is bool else value
