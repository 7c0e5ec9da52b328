"""Margins of the joint loop against the closed form of an integrator behind a delay; gains within them."""

import math

import pytest

from testbed.commissioning.findings import MARGINS, Margins, gain_within, margins_of


@pytest.mark.parametrize(("gain", "lag"), [(2.0, 0.1), (10.0, 0.02), (0.5, 0.6)])
def test_an_integrator_behind_a_delay_has_the_known_margins(gain: float, lag: float) -> None:
    found = margins_of(gain, lag, 0.0)
    assert found.phase == pytest.approx(math.pi / 2.0 - gain * lag, abs=0.03)
    assert found.gain == pytest.approx(math.pi / 2.0 / (lag * gain), rel=0.02)


def test_an_integrator_with_a_filter_alone_never_loses_its_gain_margin() -> None:
    assert margins_of(3.0, 0.0, 0.19).gain == math.inf


def test_gains_are_lowered_to_the_margins_and_never_raised() -> None:
    assert gain_within(2.0, 0.01, 0.0, MARGINS) == 2.0
    lowered = gain_within(17.0, 0.1, 0.0, MARGINS)
    found = margins_of(lowered, 0.1, 0.0)
    assert lowered == pytest.approx(math.pi / 2.0 / 3.0 / 0.1, rel=0.03)  # here the gain margin binds
    assert found.gain >= MARGINS.gain * 0.999
    assert found.phase >= MARGINS.phase
    assert gain_within(4.0, 0.1, 0.19, Margins(math.radians(60.0), 2.0)) < 4.0
