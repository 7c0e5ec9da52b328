"""What a valve does, undone: the flow curve and the hysteresis, each against its own forward model."""

import numpy as np
import pytest

from controller.core.servo.joint_control import opening_for, without_play

CURVE = np.array([[0.0, 0.0], [0.1, 0.03], [0.3, 0.2], [0.9, 1.0]])


@pytest.mark.parametrize("flow", [0.0, 1e-6, 0.03, 0.1, 0.2, 0.7, 1.0])
def test_the_opening_passes_the_wanted_flow(flow: float) -> None:
    assert np.interp(opening_for(CURVE, flow), CURVE[:, 0], CURVE[:, 1]) == pytest.approx(flow, abs=1e-15)


def test_beyond_its_last_knot_a_curve_goes_on_as_it_came() -> None:
    assert opening_for(CURVE, 1.4) == pytest.approx(0.9 + 0.4 * 0.6 / 0.8)


def test_a_straight_curve_changes_no_bit() -> None:
    straight = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])
    for flow in np.random.default_rng(1).uniform(0.0, 1.0, 200):
        assert opening_for(straight, flow) == flow


def _spool(commands: np.ndarray, half: float) -> np.ndarray:
    """A play operator of half a width ``half``, from rest at 0."""
    spool, places = 0.0, []
    for command in commands:
        spool = min(max(spool, command - half), command + half)
        places.append(spool)
    return np.array(places)


@pytest.mark.parametrize("half", [0.01, 0.025])
def test_a_spool_with_hysteresis_goes_where_it_is_wanted(half: float) -> None:
    expected = 0.3 * np.sin(np.linspace(0.0, 12.0, 2000)) + 0.1 * np.sin(np.linspace(0.0, 47.0, 2000))
    sense, furthest, commands = 1.0, 0.0, []
    for each in expected:
        command, sense, furthest = without_play(each, half, sense, furthest)
        commands.append(command)
    # it turns over only when the wanted place has come back by a tenth of the width
    assert np.abs(_spool(np.array(commands), half) - expected).max() <= 0.2 * half + 1e-12
    assert np.abs(_spool(expected, half) - expected).max() > 0.9 * half  # without it


def test_noise_does_not_throw_the_spool_to_and_fro() -> None:
    sense, furthest, commands = 1.0, 0.0, []
    for each in 0.2 + np.random.default_rng(2).uniform(-0.0015, 0.0015, 500):
        command, sense, furthest = without_play(each, 0.02, sense, furthest)
        commands.append(command)
    assert np.ptp(commands) < 0.004


def test_without_hysteresis_nothing_changes() -> None:
    assert without_play(0.1234, 0.0, -1.0, 0.5) == (0.1234, -1.0, 0.5)
