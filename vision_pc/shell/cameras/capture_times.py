"""When pictures were taken, by the numbers in their names or in a list: whatever unit these count."""

import re
from collections.abc import Sequence
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import NamedTuple

from vision_pc.core.se3 import Array

_UNITS = {"seconds": Decimal(1), "milliseconds": Decimal(1000), "microseconds": Decimal(10**6),
          "nanoseconds": Decimal(10**9)}  # fmt: skip
_EPOCH_S = (10**9, 10**10)  # Unix time from 2001 to 2286: in other units a thousand times as much
_STEP_S = (Decimal("1e-4"), Decimal(10))  # believed between two pictures that follow each other
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


class CaptureTimes(NamedTuple):
    """``times_ns`` in the given order, and the ``unit`` in which they were written."""

    times_ns: list[int]
    unit: str


def times_of(values: Sequence[Decimal]) -> CaptureTimes:
    """``values`` as times. Unix times tell their unit by their size; others, counted from zero or a start,
    are seconds unless pictures would then be more than 10 s apart.
    """
    unit = _epoch_unit(values) or _unit_by_step(values)
    return CaptureTimes([round(value * 10**9 / _UNITS[unit]) for value in values], unit)


def unix_seconds(values: Array) -> tuple[Array, str]:
    """``values`` (n,) as seconds, and their unit: of Unix times by their size, others are left alone."""
    unit = _epoch_unit([Decimal(float(value)) for value in values]) or "seconds"
    return values / float(_UNITS[unit]), unit


def times_of_names(names: Sequence[Path]) -> CaptureTimes | None:
    """The times that ``names`` are, if all of them are Unix times of one unit; None where they only count."""
    stamps = [_stamp(name.stem) for name in names]
    known = [stamp for stamp in stamps if stamp is not None]
    unit = _epoch_unit(known) if len(known) == len(stamps) else None
    return None if unit is None else CaptureTimes([round(v * 10**9 / _UNITS[unit]) for v in known], unit)


def order_of_name(name: Path) -> tuple[object, ...]:
    """What sorts names by the numbers in them: 2 before 10, and 1.5 (a time) after 1.25."""
    stamp = _stamp(name.stem)
    if stamp is not None:
        return (0, stamp, name.name)
    words = re.split(r"(\d+)", name.name)
    return (1, *(int(word) if k % 2 else word for k, word in enumerate(words)))


def _stamp(stem: str) -> Decimal | None:
    """The one number that a name is; None where it holds anything else."""
    return Decimal(stem) if stem.isascii() and _NUMBER.fullmatch(stem) else None


def _epoch_unit(values: Sequence[Decimal]) -> str | None:
    for unit, a_second in _UNITS.items():
        if values and all(_EPOCH_S[0] * a_second <= value < _EPOCH_S[1] * a_second for value in values):
            return unit
    return None


def _unit_by_step(values: Sequence[Decimal]) -> str:
    """The first unit in which values follow each other as pictures do; seconds where there is none."""
    steps = [abs(b - a) for a, b in pairwise(values)]
    step = median(steps) if steps else Decimal(0)
    fitting = (unit for unit, a_second in _UNITS.items() if _STEP_S[0] <= step / a_second <= _STEP_S[1])
    return next(fitting, "seconds")
