"""The greatest gain of a joint's loop, against the closed form of an integrator behind a delay."""

import math

import pytest

from testbed.commissioning.findings import greatest_gain


def test_an_integrator_behind_a_delay_has_the_known_gain() -> None:
    # the gain margin binds, however the bounds are rounded
    assert all(greatest_gain(0.01 * k, 0.0) == pytest.approx(math.pi / 0.06 / k) for k in range(1, 200))
    assert greatest_gain(0.0, 0.19) == pytest.approx(  # of a filter alone the phase margin does
        math.tan(math.radians(40.0)) / 0.19 / math.cos(math.radians(40.0)), rel=1e-3
    )
