"""The jerk-limited way to a reference where Ruckig has trouble to find one."""

import numpy as np
import pytest
from ruckig import InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from controller.core.trajectories.approach import AXES, AxisLimits, approach
from controller.core.trajectories.paths import Desired

# What was left of a way in the closed loop at camera rate, in one run of thirty: nanometres, nearly in phase.
LEFT = np.array([-5.300421879184114e-08, 5.295023078333294e-08, -5.295023730589321e-08])
SPEED = np.array([2.797679787145887e-05, -2.795777968189945e-05, 2.795777966706323e-05])
PUSH = np.array([-0.009844514751449915, 0.009841168393579521, -0.00984116839096881])
LIMITS = AxisLimits(
    np.array([0.1443375672974065] * 3 + [0.1209199576156145] * 3),
    np.array([0.202072594216369] * 3 + [0.2015332626926909] * 3),
    np.array([1.732050807568878] * 3 + [1.511499470195182] * 3),
)


def test_axes_that_cannot_arrive_together_arrive_each_by_itself() -> None:
    still = np.zeros(3)
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    start = Desired(LEFT, SPEED, PUSH, upright, still, still)

    request = InputParameter(AXES)  # Ruckig itself finds no way in step; if it learns to, this test is idle
    request.synchronization = Synchronization.Phase
    request.current_position = [*LEFT.tolist(), 0.0, 0.0, 0.0]
    request.current_velocity = [*SPEED.tolist(), 0.0, 0.0, 0.0]
    request.current_acceleration = [*PUSH.tolist(), 0.0, 0.0, 0.0]
    request.target_position = [0.0] * AXES
    request.max_velocity = LIMITS.speed.tolist()
    request.max_acceleration = LIMITS.acceleration.tolist()
    request.max_jerk = LIMITS.jerk.tolist()
    with pytest.raises(RuckigError):
        Ruckig(AXES).calculate(request, Trajectory(AXES))

    way = approach(start, still, upright, np.zeros(AXES), LIMITS)
    assert way is not None
    begun = way.sample(0.0)[0]
    np.testing.assert_allclose(begun.p, LEFT, atol=1e-15)
    np.testing.assert_allclose(begun.v, SPEED, atol=1e-12)
    np.testing.assert_allclose(begun.a, PUSH, atol=1e-9)
    for time_s in np.linspace(0.0, 1.1 * way.duration_s, 50):
        there = way.sample(float(time_s))[0]
        assert (np.abs(there.a) <= LIMITS.acceleration[:3]).all()
        assert np.linalg.norm(there.p) < 1e-6
    np.testing.assert_array_equal(way.sample(way.duration_s)[0].p, still)
