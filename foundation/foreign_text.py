"""Files that other programs wrote: byte order marks, what a spreadsheet makes of columns, one bad of many."""

import codecs
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from protocol.errors import ConfigurationError

Item = TypeVar("Item")
Content = TypeVar("Content")
_SHOWN = 20  # characters of what is no JSON
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


def unreadable(error: OSError | UnicodeDecodeError) -> str:
    """Why a file was not read, in words."""
    return f"no text at byte {error.start}" if isinstance(error, UnicodeDecodeError) else str(error.strerror)


def parse_json(text: str) -> Any:
    """What JSON ``text`` holds. Raises ValueError that says where it is none, or nested too deeply for the
    parser, or a key is written twice.
    """
    try:
        return json.loads(text, object_pairs_hook=_once)
    except json.JSONDecodeError as error:
        there = repr(text[error.pos :][:_SHOWN]) if text[error.pos :].strip() else "the end"
        why = f"line {error.lineno}, column {error.colno}: {there} is unexpected"
        raise ValueError(why) from error
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) < len(pairs):
        twice = next(name for name, count in Counter(name for name, _ in pairs).items() if count > 1)
        raise ValueError(f"key '{twice}' is written twice")
    return dict(pairs)


def decimal_points(lines: Sequence[str]) -> list[str]:
    """Rows whose numbers have points, of a table that may have decimal commas between semicolons or tabs, as
    spreadsheets save it, or between blanks. Raises ValueError where a comma may as well stand between
    thousands.
    """
    head = lines[0] if lines else ""
    signs = (sign for sign in ";\t" if sign in head and all(c.count(",") < 2 for c in head.split(sign)))
    sign = next(signs, None)
    rows = [[cell.strip(' "') for cell in line.split(sign)] for line in lines]
    commas = [cell for row in rows for cell in row if "," in cell]
    alone = commas and all(map(_DECIMAL_COMMA.fullmatch, commas)) and all(len(row) > 1 for row in rows)
    if sign is None and not alone:
        return list(lines)
    decimal = [cell for cell in commas if _DECIMAL_COMMA.fullmatch(cell)]
    points = (cell for row in rows for cell in row if _DECIMAL_POINT.fullmatch(cell))
    if decimal and (point := next(points, "")):
        raise ValueError(f"{decimal[0]} and {point}: decimal commas or points are wanted, not both")
    grouped = next((cell for row in rows for cell in row if _GROUPED.fullmatch(cell)), "")
    if grouped or (decimal and all(map(_THOUSANDS.fullmatch, decimal))):
        why = "its comma may stand before decimals or between thousands: decimal points are wanted"
        raise ValueError(f"{grouped or decimal[0]}: {why}")
    return [",".join(c.replace(",", ".") if _DECIMAL_COMMA.fullmatch(c) else c for c in row) for row in rows]


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
