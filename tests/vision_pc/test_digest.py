"""The fingerprint of results: one bit is enough to change it, what is the same has the same."""

import numpy as np
import pytest

from vision_pc.core.buffers import digest
from vision_pc.core.types import StereoOffset

OFFSET = StereoOffset(0.25, -0.5, 0.01, 0.02)


def test_the_same_values_have_the_same_digest_wherever_they_are_kept() -> None:
    again = StereoOffset(*np.array(OFFSET, dtype=np.float64))
    assert digest(OFFSET, np.eye(3), {"a": 1, "b": 2}) == digest(again, np.eye(3).T, {"b": 2, "a": 1})


@pytest.mark.parametrize(
    "other",
    [
        OFFSET._replace(x_px=np.nextafter(0.25, 1.0)),
        OFFSET._replace(y_px=0.5),
        (*OFFSET, None),
        OFFSET[:3],
    ],
)
def test_one_bit_or_one_part_more_or_less_gives_another(other: tuple[float, ...]) -> None:
    assert digest(other) != digest(OFFSET)


def test_kinds_and_shapes_are_told_apart() -> None:
    values = (1, 1.0, "1", None, (1,), np.ones(1), np.ones((1, 1)), np.ones(2))
    different = [digest(value) for value in values]
    assert len(set(different)) == len(different)


def test_what_has_no_digest_is_refused() -> None:
    with pytest.raises(TypeError, match="no digest of set"):
        digest({1, 2})
