"""Paths: end conditions, geodesics, waypoints at rest, re-planning without a step, stops along the path."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from controller.config import ControllerConfig
from controller.core.settings import settings_from
from controller.core.trajectories.motion import advance, at_standstill, start_motion, start_stop
from controller.core.trajectories.paths import Desired, Path, at_rest, path_from
from nominal_arm.description import NominalArm


def _wxyz(rotation: Rotation) -> np.ndarray:
    x, y, z, w = rotation.as_quat()
    return np.array([w, x, y, z])


def _rotation(q: np.ndarray) -> Rotation:
    return Rotation.from_quat([q[1], q[2], q[3], q[0]])


START = at_rest(
    np.array([3.9, 0.0, 1.0]), _wxyz(Rotation.from_euler("xyz", [90.0, 180.0, -90.0], degrees=True))
)


def _random_path(seed: int, waypoints: int = 1, seconds: float = 2.0, dwell: float = 0.0) -> Path:
    rng = np.random.default_rng(seed)
    p = START.p + rng.uniform(-0.4, 0.4, (waypoints, 3))
    turns = [
        Rotation.from_rotvec(rng.uniform(-0.8, 0.8, 3)) * _rotation(START.quaternion)
        for _ in range(waypoints)
    ]
    quaternions = np.array([_wxyz(turn) for turn in turns])
    return path_from(START, p, quaternions, np.full(waypoints, seconds), dwell)


def test_a_path_from_rest_is_straight_and_turns_about_one_axis() -> None:
    path = _random_path(1)
    line = path.sample(2.0)[0].p - START.p
    whole = (_rotation(path.goals[0]) * _rotation(START.quaternion).inv()).as_rotvec()
    for t in np.linspace(0.0, 2.0, 41):
        here, _ = path.sample(t)
        s = t / 2.0
        blend = 10 * s**3 - 15 * s**4 + 6 * s**5
        assert here.p == pytest.approx(START.p + blend * line, abs=1e-12)
        turned = (_rotation(here.quaternion) * _rotation(START.quaternion).inv()).as_rotvec()
        assert turned == pytest.approx(blend * whole, abs=1e-12)


def test_a_path_ends_exactly_on_its_goal_and_at_rest() -> None:
    path = _random_path(2, waypoints=3, dwell=0.5)
    assert path.duration_s == pytest.approx(3 * 2.0 + 2 * 0.5)
    for time_s in (path.duration_s, path.duration_s + 5.0):
        end, segment = path.sample(time_s)
        assert segment == 2
        assert np.array_equal(end.quaternion, path.goals[2])
        for rate in (end.v, end.a, end.omega, end.alpha):
            assert not rate.any()


def test_the_short_way_round_whatever_the_signs() -> None:
    goal = _wxyz(Rotation.from_rotvec([0.0, 0.0, 0.3]) * _rotation(START.quaternion))
    for sign in (1.0, -1.0):
        path = path_from(START, START.p[None], sign * goal[None], np.array([1.0]), 0.0)
        peak = max(np.linalg.norm(path.sample(t)[0].omega) for t in np.linspace(0, 1, 101))
        assert peak == pytest.approx(1.875 * 0.3, rel=1e-3)


def test_waypoints_are_passed_in_order_and_at_rest() -> None:
    path = _random_path(3, waypoints=24, seconds=1.0, dwell=0.25)
    for n in range(24):
        arrival, segment = path.sample(n * 1.25 + 1.0)
        assert segment == n
        assert np.array_equal(arrival.quaternion, path.goals[n])
        assert not arrival.v.any()
        resting, _ = path.sample(n * 1.25 + 1.2)
        assert np.array_equal(resting.p, arrival.p)


def test_velocities_and_accelerations_are_derivatives() -> None:
    path = _random_path(4, waypoints=2)
    h = 1e-5
    for t in (0.3, 1.1, 2.7, 3.5):
        before, here, after = (path.sample(t + k * h)[0] for k in (-1, 0, 1))
        assert here.v == pytest.approx((after.p - before.p) / (2 * h), abs=1e-8)
        assert here.a == pytest.approx((after.v - before.v) / (2 * h), abs=1e-7)
        spin = (_rotation(after.quaternion) * _rotation(before.quaternion).inv()).as_rotvec() / (2 * h)
        assert here.omega == pytest.approx(spin, abs=1e-8)
        assert here.alpha == pytest.approx((after.omega - before.omega) / (2 * h), abs=1e-7)


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 10_000), when=st.floats(0.05, 1.95), seconds=st.floats(0.5, 5.0))
def test_replanning_is_continuous_up_to_acceleration(seed: int, when: float, seconds: float) -> None:
    before, _ = _random_path(seed).sample(when)
    rng = np.random.default_rng(seed + 1)
    goal = _wxyz(Rotation.from_rotvec(rng.uniform(-1.0, 1.0, 3)) * _rotation(before.quaternion))
    path = path_from(
        before, (before.p + rng.uniform(-0.5, 0.5, 3))[None], goal[None], np.array([seconds]), 0.0
    )
    after, _ = path.sample(0.0)
    for name in Desired._fields:
        want, got = getattr(before, name), getattr(after, name)
        if name == "quaternion":
            got = got * np.sign(np.dot(got, want))
        assert got == pytest.approx(want, abs=1e-9), name
    end, _ = path.sample(seconds * (1.0 - 1e-9))
    assert np.abs(np.concatenate([end.v, end.omega])).max() < 1e-6
    assert abs(np.dot(end.quaternion, goal)) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("when", [0.05, 0.5, 1.0, 1.7, 3.1])
def test_a_stop_slows_along_the_path_without_a_step(
    arm: NominalArm, config: ControllerConfig, when: float
) -> None:
    limits = settings_from(arm, config).stop
    motion = start_motion(_random_path(5, waypoints=3), 7)
    dt_s = 0.001
    for _ in range(round(when / dt_s)):
        motion = advance(motion, dt_s)
    path = motion.path
    assert path is not None
    motion = start_stop(limits, motion)
    trace = [motion.desired]
    while not at_standstill(motion):
        motion = advance(motion, dt_s)
        trace.append(motion.desired)
        on_path, _ = path.sample(motion.time_s)
        assert motion.desired.p == pytest.approx(on_path.p, abs=1e-12)
    assert not motion.done
    assert not trace[-1].v.any()
    speeds = np.array([d.v for d in trace])
    assert np.abs(np.diff(speeds, axis=0)).max() < 2e-3 * config.motion.stop_acceleration_m_s2
    for before, after in pairwise(trace):
        middle = (before.v + after.v) / 2
        assert after.p - before.p == pytest.approx(middle * dt_s, abs=1e-8)


def test_a_second_stop_changes_nothing(arm: NominalArm, config: ControllerConfig) -> None:
    limits = settings_from(arm, config).stop
    motion = advance(start_motion(_random_path(6), 1), 0.7)
    once = advance(start_stop(limits, motion), 0.1)
    assert start_stop(limits, once) is once
