"""Greatest speeds and angles along a path of ROS, held against dense samples of the same path."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BPoly

from longreach_ros2.kinematics import Array
from longreach_ros2.trajectories import JointPath, Limits, _outside, joint_path, limits_of
from nominal_arm.description import JOINT_NAMES
from protocol.errors import RequestRefused
from tests.longreach_ros2.messages import ARM, HOME, point, trajectory

FREE = Limits(np.tile([-math.inf, math.inf], (6, 1)), np.full(6, math.inf))
HOME_BUT_SLEW = HOME[1:]


def drawn(rng: np.random.Generator) -> Any:
    """A trajectory of up to six points, nanoseconds to minutes apart, some with accelerations, some still."""
    count = int(rng.integers(1, 6))
    gaps_ns = np.maximum(1, 10.0 ** rng.uniform(0.0, 10.5, count)).astype(np.int64)
    scale = 10.0 ** rng.uniform(-4.0, 2.0)
    points = []
    for k, at_ns in enumerate(np.cumsum(gaps_ns)):
        turn, rate, bend = rng.normal(size=(3, 6)) * (rng.random((3, 6)) < 0.7)
        rate = np.zeros(6) if k == count - 1 else scale * rate
        more = {"accelerations": (scale * bend).tolist()} if rng.random() < 0.5 else {}
        points.append(point(0.0, np.add(HOME, turn), rate, **more))
        points[-1].time_from_start.sec, points[-1].time_from_start.nanosec = divmod(int(at_ns), 10**9)
    return trajectory(*points)


def sampled(path: JointPath) -> tuple[Array, Array]:
    """Angles and rates (…, 6) at 1,000 places of each segment."""
    places = np.linspace(path.curve.x[:-1], path.curve.x[1:], 1001).ravel()
    return path.curve(places), path.rate(places)


@pytest.mark.parametrize("seed", range(100))
def test_a_limit_is_passed_just_where_dense_samples_pass_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    message = drawn(rng)
    angles, rates = sampled(joint_path(message, HOME, FREE))
    span = np.ptp(angles, axis=0) + 1e-3
    ranges = np.stack((angles.min(axis=0) - 1e-4 * span, angles.max(axis=0) + 1e-4 * span), axis=1)
    speeds = np.abs(rates).max(axis=0) * 1.0001 + 1e-9
    joint_path(message, HOME, Limits(ranges, speeds))
    for joint, name in enumerate(JOINT_NAMES):
        if speeds[joint] > 1e-4:
            slower = speeds.copy()
            slower[joint] *= 0.999
            error = refused(message, Limits(ranges, slower))
            assert error.cause == "refused.ros_too_fast"
            said, number = str(error).split(" at ")[0], float(str(error).split()[2])
            assert said == name
            assert number == pytest.approx(math.degrees(speeds[joint]), rel=1e-3, abs=0.01)
        for end in (0, 1):
            tighter = ranges.copy()
            tighter[joint, end] += (1 - 2 * end) * (2e-4 * span[joint] + 1e-5)
            error = refused(message, Limits(tighter, speeds))
            assert error.cause == "refused.ros_joint_limit"
            assert str(error).startswith(f"{name} at ")


def refused(message: Any, limits: Limits) -> RequestRefused:
    """How the bridge refuses the trajectory."""
    with pytest.raises(RequestRefused) as caught:
        joint_path(message, HOME, limits)
    return caught.value


def at(time_ns: int, slew: float) -> Any:
    """A point at rest, the other joints at home."""
    made = point(0.0, (slew, *HOME_BUT_SLEW))
    made.time_from_start.sec, made.time_from_start.nanosec = divmod(time_ns, 10**9)
    return made


@pytest.mark.parametrize("lasts_ns", [1, 1_000, 999_999, 1_000_000, 10_000_000, 20_000_000, 21_000_000])
def test_however_short_a_motion_is_its_speed_counts(lasts_ns: int) -> None:
    speed = math.degrees(1.5 / (1e-9 * lasts_ns))  # a cubic from rest to rest: 3/2 of the mean
    whole = refused(trajectory(at(lasts_ns, 1.0)), limits_of(ARM))
    assert whole.cause == "refused.ros_too_fast"
    assert f"slew at {speed:.2f} deg/s after {5e-10 * lasts_ns:.9g} s, limit 15.00 deg/s" in str(whole)
    spike = [at(0, 0.0), at(10**9, 0.0), at(10**9 + lasts_ns, 0.5), at(10**9 + 2 * lasts_ns, 0.0)]
    assert refused(trajectory(*spike, at(3 * 10**9, 0.0)), limits_of(ARM)).cause == "refused.ros_too_fast"


@pytest.mark.parametrize("later_ns", [0, -1, -1_000_000, -(10**9)])
def test_times_that_stand_still_or_go_back_are_refused(later_ns: int) -> None:
    error = refused(trajectory(at(2 * 10**9, 0.01), at(2 * 10**9 + later_ns, 0.01)), limits_of(ARM))
    assert error.cause == "refused.ros_times"
    assert "point 1 is at" in str(error)


def test_a_short_step_within_the_limits_is_followed() -> None:
    step_rad = 1e-9 * math.radians(15.0) * 0.6
    path = joint_path(trajectory(at(1, step_rad), at(2 * 10**9, 0.0)), HOME, limits_of(ARM))
    assert path.goal[0] == 0.0


def test_a_cubic_that_is_written_as_a_quintic_keeps_its_greatest_speed() -> None:
    # The rate, in Bernstein's basis, of a cubic of 18 µs beside a quintic: its quartic terms are rounding.
    row = [-1.8211261245102618e-04, -1.8211261245102623e-04]
    row += [6.0637468041133630e04, 9.0956201901511362e04, -1.1870941220358039e-03]
    rate = BPoly(np.tile(np.array(row)[:, None, None], (1, 1, 6)), [0.0, 1.0])
    greatest = float(rate(np.linspace(0.0, 1.0, 10_001)).max())
    found = _outside(rate, np.full(6, -math.inf), np.full(6, 0.9 * greatest))
    assert found is not None
    assert found[2] == pytest.approx(greatest, rel=1e-6)
