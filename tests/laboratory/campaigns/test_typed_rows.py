"""Typed rows: what is written flat is read back as it was, and what is missing is never a number."""

import math
from typing import NamedTuple

from laboratory.campaigns.rows import XYZ, flat, typed


class Leg(NamedTuple):
    true_mm: XYZ
    steps: int | None
    failure: str


class Run(NamedTuple):
    seed: int
    passed: bool
    look1: Leg
    speed_m_s: float


RUN = Run(3, True, Leg(XYZ(1.0, -2.0, 0.5), 2, ""), 0.25)


def test_columns_are_named_after_fields_with_the_axis_before_the_unit() -> None:
    assert flat(RUN) == {
        "seed": 3, "passed": True, "look1_true_x_mm": 1.0, "look1_true_y_mm": -2.0, "look1_true_z_mm": 0.5,
        "look1_steps": 2, "look1_failure": "", "speed_m_s": 0.25,
    }  # fmt: skip
    assert flat(RUN._asdict()) == flat(RUN), "typed rows in a mapping have the same columns"


def test_a_row_is_read_back_as_its_type() -> None:
    assert typed(Run, flat(RUN)) == RUN


def test_what_a_failed_row_lacks_is_not_a_number() -> None:
    row = typed(Run, {"seed": 1})
    assert math.isnan(row.speed_m_s)
    assert all(math.isnan(value) for value in row.look1.true_mm)
    assert (row.passed, row.look1.steps, row.look1.failure) == (False, None, "")
