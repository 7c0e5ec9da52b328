"""Play and the camera's delay from drawn triangles: both kinds of play, a late camera, a sinking joint."""

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from vision_pc.core.calibration.joint_motion import JointSeen
from vision_pc.core.calibration.joint_play import joint_play, mean_delay
from vision_pc.core.se3 import Array, exp_so3, transform

_LEVER_M = 3.0
_DT_S = 0.01
_FRAME_S = 0.1


def dragged(q: Array, half: float) -> Array:
    """What lies ``half`` to either side of ``q`` and is dragged along by it."""
    lies = np.empty_like(q)
    here = q[0]
    for k, angle in enumerate(q):
        here = min(max(here, angle - half), angle + half)
        lies[k] = here
    return lies


def seen_of(
    encoder_side: float = 0.0, load_side: float = 0.0, late_s: float = 0.0, seed: int = 0, triangles: int = 6
) -> JointSeen:
    """Triangles of a joint out and back, the play (half, rad) before its encoder and behind it."""
    rng = np.random.default_rng(seed)
    halves, valves = [], []
    for k in range(triangles):
        n = int(rng.integers(350, 500))
        shape = 1.0 - np.abs(np.linspace(-1.0, 1.0, n))
        sense = 1.0 if k % 2 == 0 else -1.0
        halves += [sense * rng.uniform(0.025, 0.04) * shape, np.zeros(60)]
        valves += [sense * (0.05 + 0.03 * shape), np.zeros(60)]
    speed, valve = np.concatenate(halves), np.concatenate(valves)
    joint = np.cumsum(speed) * _DT_S
    t = _DT_S * np.arange(len(joint))
    q = np.zeros((len(t), 6))
    q[:, 0] = dragged(joint, encoder_side) + 3e-6 * rng.standard_normal(len(t))
    q[:, 4] = -3e-4 * t - 2e-6 * t**2  # a wrist that sinks
    load = dragged(joint, load_side)
    frames = np.arange(5, len(t) - 5, round(_FRAME_S / _DT_S))
    poses = [_camera(load[k], q[k, 4], rng) for k in frames]
    return JointSeen(0, t, q, valve, t[frames] + late_s, np.array(poses))


def _camera(slew: float, wrist: float, rng: np.random.Generator) -> Array:
    R = exp_so3(np.array([0.0, 0.0, slew])) @ exp_so3(np.array([0.0, wrist, 0.0]))
    p = _LEVER_M * np.array([np.cos(slew) - 1.0, np.sin(slew), 0.0]) + 0.4 * np.array([0.0, 0.0, wrist])
    X = transform(R @ exp_so3(1e-5 * rng.standard_normal(3)), p + 2e-5 * rng.standard_normal(3))
    return np.asarray(X)


@pytest.mark.parametrize("seed", range(3))
def test_play_before_the_encoder_is_found_with_an_honest_spread(seed: int) -> None:
    true = np.random.default_rng(seed).uniform(1e-4, 6e-4)
    found = joint_play(seen_of(encoder_side=true, late_s=0.012, seed=seed))
    assert found.half == pytest.approx(true, rel=0.1)
    assert abs(found.half - true) < 3.5 * found.half_std
    assert found.half_std < 0.1 * true
    assert found.delay == pytest.approx(0.012, abs=0.002)
    assert abs(found.delay - 0.012) < 3.5 * found.delay_std


@pytest.mark.parametrize("seed", range(3))
def test_a_boom_that_swings_beside_its_joint_is_not_taken_for_play(seed: int) -> None:
    seen = seen_of(encoder_side=2e-4, seed=seed)
    swing = np.array([exp_so3(np.array([0.0, 0.0, 6e-4 * np.sin(9.0 * t + 0.3)])) for t in seen.seen_t])
    turned = seen.X_C0C.copy()
    turned[:, :3, 3] = (swing @ (turned[:, :3, 3] + [_LEVER_M, 0.0, 0.0])[..., None])[..., 0]
    turned[:, :3, 3] -= [_LEVER_M, 0.0, 0.0]
    turned[:, :3, :3] = swing @ turned[:, :3, :3]
    found = joint_play(seen._replace(X_C0C=turned))
    assert found.half == pytest.approx(2e-4, rel=0.2)
    assert abs(found.half - 2e-4) < 3.5 * found.half_std
    assert found.half_std < 2.5e-5  # 6e-5 and more without the swings


@pytest.mark.parametrize("seed", range(3))
def test_stamps_that_scatter_do_not_widen_the_play(seed: int) -> None:
    seen = seen_of(encoder_side=2e-4, late_s=0.008, seed=seed)
    scatter = 0.003 * np.random.default_rng(seed).standard_normal(len(seen.seen_t))
    found = joint_play(seen._replace(seen_t=seen.seen_t + scatter))
    assert found.half == pytest.approx(2e-4, rel=0.1)
    assert found.half_std < 8e-6  # 8.8e-6 to 1.3e-5 by the stamps as told
    assert found.delay == pytest.approx(0.008, abs=0.0012)


def on_a_boom(seen: JointSeen, hertz: float, damping: float) -> JointSeen:
    """``seen`` from the tip of a boom that swings at ``hertz`` when its root turns, by small Euler steps."""
    omega, fine = 2.0 * np.pi * hertz, 20
    times = np.arange(seen.t[0], seen.t[-1], _DT_S / fine)
    root = np.interp(times, seen.t, np.convolve(seen.q[:, 0], np.ones(9) / 9.0, "same"))
    tip, speed, bent = root[0], 0.0, np.zeros(len(times))
    for k, angle in enumerate(root):
        speed += _DT_S / fine * (omega**2 * (angle - tip) - 2.0 * damping * omega * speed)
        tip += _DT_S / fine * speed
        bent[k] = tip - angle
    turned = seen.X_C0C.copy()
    for X, angle in zip(turned, np.interp(seen.seen_t, times, bent), strict=True):
        R = exp_so3(np.array([0.0, 0.0, angle]))
        X[:3, 3] = R @ (X[:3, 3] + [_LEVER_M, 0.0, 0.0]) - [_LEVER_M, 0.0, 0.0]
        X[:3, :3] = R @ X[:3, :3]
    return seen._replace(X_C0C=turned)


@pytest.mark.parametrize("seed", range(3))
def test_a_boom_that_its_joint_sets_swinging_is_not_taken_for_play(seed: int) -> None:
    found = joint_play(on_a_boom(seen_of(encoder_side=2e-4, seed=seed), 1.5, 0.01))
    assert found.half == pytest.approx(2e-4, rel=0.05)
    assert abs(found.half - 2e-4) < 3.5 * found.half_std
    assert found.half_std < 1e-5  # 1.4e-5 to 2.7e-5 by a swing of each triangle's own, and up to 13 % off


def test_loose_steel_behind_the_encoder_has_the_other_sign() -> None:
    found = joint_play(seen_of(load_side=4e-4))
    assert found.half == pytest.approx(-4e-4, rel=0.1)


def test_a_joint_without_play_has_none() -> None:
    found = joint_play(seen_of())
    assert abs(found.half) < 3.5 * found.half_std + 3e-6
    assert found.half_std < 2e-5


def test_too_few_triangles_are_refused() -> None:
    with pytest.raises(MeasurementFailed, match="1 triangles out and back") as raised:
        joint_play(seen_of(triangles=2))
    assert raised.value.cause == "measurement.play_unseen"


def test_a_camera_that_stood_still_is_refused() -> None:
    seen = seen_of()
    with pytest.raises(MeasurementFailed) as raised:
        joint_play(seen._replace(X_C0C=np.tile(np.eye(4), (len(seen.seen_t), 1, 1))))
    assert raised.value.cause == "measurement.play_unseen"


def test_delays_of_joints_are_weighed_and_their_scatter_counts() -> None:
    one = joint_play(seen_of(encoder_side=2e-4, late_s=0.01))
    sure = one._replace(delay=0.01, delay_std=0.001)
    mean, std = mean_delay([sure, sure._replace(delay=0.012), one._replace(delay=0.5, delay_std=1.0)])
    assert mean == pytest.approx(0.011, abs=1e-4)
    assert std == pytest.approx(0.001 / np.sqrt(2.0), rel=0.1)
    _, wide = mean_delay([sure, sure._replace(delay=0.03)])
    assert wide > 0.005
