"""The controller on the real plant emulator, through the process image's words, in lockstep.

Prints its figures; run with -s to see them: pytest tests/controller/test_closed_loop.py -s
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from controller.core.servo.servo_step import resolve, tool_state
from controller.core.settings import ScanSettings
from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.plant import Plant
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import ReferencePath, ReferencePose
from testbed.lockstep.clock import ClosedLoop
from tests.controller.conftest import CONFIGS

pytestmark = pytest.mark.slow("motions of the emulated plant, to rest")

STATIC_ERROR_MRAD = 0.3
HOLD_S = 4.0


def _loop(settings: ScanSettings, payload_kg: float, seed: int = 1) -> ClosedLoop:
    plant = load(PlantConfig, CONFIGS / "plant.yaml", {"payload": {"mass_kg": payload_kg}})
    loop = ClosedLoop(settings, Plant(plant, seed))
    loop.enable()
    return loop


def _targets(seed: int) -> Iterator[Pose]:
    """Random poses where the demonstration lives, turned by up to 10° about each axis."""
    rng = np.random.default_rng(seed)
    level = Rotation.from_matrix([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    while True:
        p = rng.uniform([3.3, -0.7, 0.5], [4.2, 0.7, 1.5])
        x, y, z, w = (Rotation.from_rotvec(np.radians(rng.uniform(-10.0, 10.0, 3))) * level).as_quat()
        yield Pose((float(p[0]), float(p[1]), float(p[2])), (float(w), float(x), float(y), float(z)))


class Arrival(NamedTuple):
    """``settle_s``: from the path's end to the settled flag; joint figures over HOLD_S afterwards."""

    settle_s: float
    lag_mm: float
    error_mrad: float
    wander_mrad: float


def _arrive(loop: ClosedLoop, target: Pose) -> Arrival:
    assert loop.refer(lambda i: ReferencePose(i, target, 0.0)) is Reason.ACCEPTED
    lag = 0.0
    while not loop.view.motion_done:
        loop.step()
        assert loop.view.fault is FaultCode.NONE
        lag = max(lag, float(np.linalg.norm(np.subtract(loop.view.X_BT.p_m, loop.view.X_BT_cmd.p_m))))
    settle_s = loop.settle(20.0)
    settings, joints, errors = loop.settings, [], []
    for _ in range(round(HOLD_S / settings.cycle_s)):
        loop.step()
        joints.append(loop.view.q_meas)
        tool = tool_state(settings.table, np.array(loop.view.q_meas))
        errors.append(resolve(tool, loop.state.motion.desired, settings.servo.gains, np.zeros(6)).q_error)
    return Arrival(
        settle_s,
        1e3 * lag,
        1e3 * float(np.abs(errors).mean(axis=0).max()),
        1e3 * float(np.ptp(joints, axis=0).max()),
    )


def _judge(arrivals: list[Arrival], heading: str) -> None:
    columns = np.array(arrivals)
    print(f"\n{heading}: settle, s: median {np.median(columns[:, 0]):.1f}, longest {columns[:, 0].max():.1f}")
    print(f"  path lag, mm, largest: {columns[:, 1].max():.1f}")
    print(
        f"  static joint error, mrad, largest: {columns[:, 2].max():.2f}; wander: {columns[:, 3].max():.2f}"
    )
    assert columns[:, 1].max() < 25.0
    assert columns[:, 2].max() <= STATIC_ERROR_MRAD
    assert columns[:, 3].max() < 0.6  # hunting would show as a standing wave of milliradians


@pytest.mark.parametrize("payload_kg", [0.0, 100.0])
def test_settles_within_a_third_of_a_milliradian_and_does_not_hunt(
    settings: ScanSettings, payload_kg: float
) -> None:
    loop = _loop(settings, payload_kg)
    targets = _targets(round(payload_kg))
    _judge([_arrive(loop, next(targets)) for _ in range(2)], f"payload {payload_kg:.0f} kg")


@pytest.mark.experiment
def test_settles_everywhere_with_any_payload(settings: ScanSettings) -> None:
    rng = np.random.default_rng(20)
    arrivals = []
    for seed in range(12):
        loop, targets = _loop(settings, rng.uniform(0.0, 100.0), seed), _targets(100 + seed)
        arrivals += [_arrive(loop, next(targets)) for _ in range(3)]
    _judge(arrivals, f"{len(arrivals)} arrivals")


def test_enabling_and_holding_do_not_move_a_loaded_arm(settings: ScanSettings) -> None:
    loop = _loop(settings, 50.0)
    before = loop.plant.truth().X_BT
    loop.run(5.0)
    assert np.linalg.norm(loop.plant.truth().X_BT[:3, 3] - before[:3, 3]) < 2e-3
    assert loop.view.group_state is GroupState.STANDBY


def test_a_circle_of_waypoints_is_tracked(settings: ScanSettings) -> None:
    loop = _loop(settings, 30.0)
    centre = loop.view.X_BT
    angles = np.linspace(0.0, 2.0 * np.pi, 17)[:-1]
    ring = [(0.0, 0.2 * np.cos(a), 0.2 * np.sin(a)) for a in angles]
    points = [np.add(centre.p_m, offset) for offset in ((0.0, 0.0, 0.0), *ring, (0.0, 0.0, 0.0))]
    waypoints = tuple(Pose((float(p[0]), float(p[1]), float(p[2])), centre.q_wxyz) for p in points)
    assert loop.refer(lambda i: ReferencePath(i, waypoints, 0.0, 0.0)) is Reason.ACCEPTED
    lag = []
    while not loop.view.motion_done:
        loop.step()
        assert loop.view.fault is FaultCode.NONE
        lag.append(1e3 * float(np.linalg.norm(np.subtract(loop.view.X_BT.p_m, loop.view.X_BT_cmd.p_m))))
    rms = float(np.sqrt(np.mean(np.square(lag))))
    print(f"\n18 waypoints on a circle of 0.2 m: lag, mm, rms {rms:.1f}, largest {max(lag):.1f}")
    assert max(lag) < 30.0


def test_emergency_stop_in_motion_closes_every_valve_within_a_cycle(settings: ScanSettings) -> None:
    loop = _loop(settings, 100.0)
    here = loop.view.X_BT
    goal = Pose((here.p_m[0], here.p_m[1], here.p_m[2] - 0.4), here.q_wxyz)
    assert loop.refer(lambda i: ReferencePose(i, goal, 0.0)) is Reason.ACCEPTED
    loop.run(1.5)
    assert loop.command(CommandCode.EMERGENCY_STOP) is Reason.ACCEPTED
    loop.step()
    loop.run(0.05)
    assert not loop.plant.truth().valves.any()
    loop.run(2.0)
    resting = loop.plant.truth().q
    loop.run(1.0)
    assert np.abs(loop.plant.truth().q - resting).max() < 3e-3  # the oil's spring still rings
