"""A product and a sum, rounded once: the same in a kernel and in plain Python."""

import math

import pytest

from foundation.compiled import fused, kernel


@kernel
def _in_a_kernel(a: float, b: float, c: float) -> float:
    return fused(a, b, c)


@pytest.mark.parametrize(
    ("a", "b", "c"),
    [(0.1, 10.0, -1.0), (1.0 + 2.0**-52, 1.0 - 2.0**-52, -1.0), (1e200, 1e200, -1e300), (math.inf, 1.0, 2.0)],
)
def test_it_is_the_same_in_a_kernel_and_outside(a: float, b: float, c: float) -> None:
    assert _in_a_kernel(a, b, c) == fused(a, b, c)


def test_it_differs_from_what_is_rounded_twice() -> None:
    assert fused(0.1, 10.0, -1.0) == _in_a_kernel(0.1, 10.0, -1.0) == 2.0**-54
    assert 0.1 * 10.0 - 1.0 == 0.0
