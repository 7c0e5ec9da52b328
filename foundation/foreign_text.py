"""Files that other programs wrote: byte order marks, what a spreadsheet makes of columns, one bad of many."""

import codecs
import csv
import io
import json
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from protocol.errors import ConfigurationError

Item = TypeVar("Item")
Content = TypeVar("Content")
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_DECIMAL_POINT = re.compile(r"[-+]?\d*\.\d+([eE][-+]?\d+)?")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")
_GROUPED = re.compile(r"[-+]?\d{1,3}(\.\d{3})+,\d+|[-+]?\d{1,3}(,\d{3})+\.\d+")


def decoded(data: bytes) -> str:
    """``data`` as text: UTF-8 with or without a byte order mark, or UTF-16 with one. Raises
    UnicodeDecodeError.
    """
    return data.decode("utf-16" if data.startswith(_UTF16) else "utf-8-sig")


def read_text(path: Path) -> str:
    """What is in the file, as ``decoded`` has it. Raises OSError, UnicodeDecodeError."""
    return decoded(path.read_bytes())


def parse_json(text: str) -> Any:
    """What JSON ``text`` holds. Raises ValueError, also where it is nested too deeply for the parser."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def comma_separated(lines: Sequence[str]) -> list[str]:
    """Rows with commas between columns and points in numbers, of a table that may have semicolons or tabs,
    and then decimal commas, as spreadsheets save it. The first row tells. Raises ValueError where a comma may
    as well stand between thousands.
    """
    if any(len(line) > csv.field_size_limit() for line in lines):
        raise ValueError(f"a line is longer than {csv.field_size_limit()} characters")
    head = lines[0] if lines else ""
    signs = (sign for sign in ";\t" if sign in head and all(c.count(",") < 2 for c in head.split(sign)))
    sign = next(signs, None)
    if sign is None:
        return list(lines)
    try:
        rows = list(csv.reader(lines, delimiter=sign, skipinitialspace=True))
    except csv.Error as error:
        raise ValueError(str(error)) from error
    if len(rows) != len(lines):
        raise ValueError("a cell goes over several lines")
    decimal = [cell for row in rows for cell in row if _DECIMAL_COMMA.fullmatch(cell.strip())]
    points = (cell.strip() for row in rows for cell in row if _DECIMAL_POINT.fullmatch(cell.strip()))
    if decimal and (point := next(points, "")):
        raise ValueError(f"{decimal[0].strip()} and {point}: decimal commas or points are wanted, not both")
    grouped = next((cell for row in rows for cell in row if _GROUPED.fullmatch(cell.strip())), "")
    if grouped or (decimal and all(map(_THOUSANDS.fullmatch, map(str.strip, decimal)))):
        why = "its comma may stand before decimals or between thousands: decimal points are wanted"
        raise ValueError(f"{(grouped or decimal[0]).strip()}: {why}")
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    for row in rows:
        table.writerow([c.replace(",", ".") if _DECIMAL_COMMA.fullmatch(c.strip()) else c for c in row])
    return text.getvalue().splitlines()


def read_each(
    items: Iterable[Item], read: Callable[[Item], Content]
) -> tuple[list[tuple[Item, Content]], list[str]]:
    """What ``read`` finds in each item where it can, and of the others why not. Raises ConfigurationError
    where it can in none.
    """
    found, bad = list[tuple[Item, Content]](), list[ConfigurationError]()
    for item in items:
        try:
            found.append((item, read(item)))
        except ConfigurationError as error:
            bad.append(error)
    if bad and not found:
        raise bad[0]
    return found, [f"left out: {error}" for error in bad]
