"""The console's own measurements: often while the arm moves, seldom at rest."""

import numpy as np

from vision_pc.application.console.overview import MeasuringPace


def times(joints_at: object, until_s: float = 10.0) -> int:
    pace, count = MeasuringPace(), 0
    for tick in range(round(until_s * 10)):
        count += pace.due(0.1 * tick, joints_at(0.1 * tick))  # type: ignore[operator]
    return count


def test_a_moving_arm_is_measured_twice_a_second() -> None:
    assert times(lambda now_s: np.array([0.0, 0.01 * now_s])) in (19, 20, 21)


def test_an_arm_at_rest_seldom_and_noise_of_the_encoders_is_rest() -> None:
    rng = np.random.default_rng(1)
    assert times(lambda _: rng.uniform(-4e-5, 4e-5, 3)) == 4


def test_an_arm_that_nobody_knows_counts_as_moving() -> None:
    assert times(lambda _: None) in (19, 20, 21)


def test_the_first_motion_after_rest_is_measured_at_once() -> None:
    pace = MeasuringPace()
    assert pace.due(0.0, np.zeros(2))
    assert not pace.due(1.0, np.zeros(2))
    assert pace.due(1.1, np.array([0.0, 3e-3]))
