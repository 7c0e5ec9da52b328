"""A refusal tells its value and limit with their unit, and the units are those of the written protocol."""

import math
import re

import pytest

from protocol.faults import REASON_TEXTS, REASON_UNITS, Reason, refusal


@pytest.mark.parametrize(
    ("reason", "value", "limit", "told"),
    [
        (Reason.TOO_FAR, 8.99744, 3.0, "move refused: too far: 8.99744 m, limit 3 m"),
        (Reason.JOINT_LIMIT, math.radians(89.64), math.radians(89.5),
         "move refused: joint limit: 89.64 deg, limit 89.50 deg"),
        (Reason.TOO_FAST, 1.2, 1.0, "move refused: too fast: 1.2, limit 1"),
        (Reason.DISABLED, 0.0, 0.0, "move refused: disabled"),
    ],
)  # fmt: skip
def test_a_refusal_names_the_unit(reason: Reason, value: float, limit: float, told: str) -> None:
    refused = refusal("move", reason, value, limit)
    assert (str(refused), refused.cause) == (told, f"refused.{reason.name.lower()}")


def test_units_are_those_of_the_written_protocol() -> None:
    written = {
        reason: units.pop()
        for reason, text in REASON_TEXTS.items()
        if len(units := set(re.findall(r" in (m|rad|s)\b", text.partition("v ")[2]))) == 1
    }
    del written[Reason.SINGULAR]  # a singular value, or an angle
    assert written == REASON_UNITS
