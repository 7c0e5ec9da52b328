"""A campaign's flat rows as types: one NamedTuple an experiment, its columns named after its fields.

A field that is a NamedTuple itself gives its name to its columns (``look1`` with ``steps``: ``look1_steps``),
one that is an ``XYZ`` is three columns with the axis before the unit (``true_mm``: ``true_x_mm`` …).
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from testbed.campaigns.row_file import Row

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
    return kind(**{name: _value(hint, f"{prefix}{name}", row) for name, hint in _hints(kind).items()})


def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def _columns(name: str) -> list[str]:
    stem, _, unit = name.rpartition("_")
    return [f"{stem}_{axis}_{unit}" for axis in "xyz"]


def _value(hint: Any, name: str, row: Row) -> Any:
    if hint is XYZ:
        return XYZ(*(_value(float, column, row) for column in _columns(name)))
    if hasattr(hint, "_fields"):
        return typed(hint, row, f"{name}_")
    value = row.get(name)
    if hint is float:
        return math.nan if value is None else float(value)
    if hint is str:
        return "" if value is None else str(value)
    return bool(value) if hint is bool else value
