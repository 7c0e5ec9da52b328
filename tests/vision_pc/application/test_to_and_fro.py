"""How far an arm that never settles goes to and fro, by the states of its controller."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.vision_pc.shell.loopback_controller import CYCLE_S, LoopbackController
from tests.vision_pc.synthetic import SyntheticRig, draw
from vision_pc.application.link_arm import _to_and_fro
from vision_pc.core.se3 import Array

_DIGIT_RAD = 4.8e-5


@pytest.mark.parametrize(
    ("motion", "told_rad"),
    [
        (lambda t: 4e-4 * np.sin(2.0 * np.pi * 0.3 * t), 8e-4),
        (lambda t: 2e-5 * t, 0.0),
        (lambda t: 0.0 * t, 0.0),
        (lambda t: 5e-5 * t, 9e-4),
    ],
    ids=["hunts", "creeps", "stands", "goes one way"],
)
def test_neither_creep_nor_noise_is_to_and_fro(motion: Callable[[Array], Array], told_rad: float) -> None:
    """The digits of a crane's encoders alone had been told as 0.7 mm at its tool."""
    state = LoopbackController(SyntheticRig(draw(np.random.default_rng(0)), 0)).state()
    times = np.arange(0.0, 18.0, CYCLE_S)
    noise = np.random.default_rng(2).normal(0.0, 0.3 * _DIGIT_RAD, (len(times), 6))
    q_meas = _DIGIT_RAD * np.round((motion(times)[:, None] + noise) / _DIGIT_RAD)
    states = [
        state._replace(time_ns=int(1e9 * t), q_meas=tuple(q)) for t, q in zip(times, q_meas, strict=True)
    ]
    assert _to_and_fro(states) == pytest.approx(told_rad, abs=3.5e-5)
