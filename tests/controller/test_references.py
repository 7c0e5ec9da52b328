"""Admission: what cannot be done is refused whole, with value and limit, and nothing moves."""

import math

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.kinematics.rotations import quaternion_from_matrix
from controller.core.servo.servo_step import tool_state
from controller.core.settings import ScanSettings
from nominal_arm.description import NominalArm
from protocol.faults import FaultCode, Reason
from protocol.pose import Pose
from protocol.reference_messages import ReferencePath
from tests.controller.obedient_plant import Bench


@pytest.fixture
def bench(settings: ScanSettings) -> Bench:
    return Bench(settings).enabled()


def _turned(pose: Pose, axis: int, angle: float) -> Pose:
    """The pose turned about one of its own axes."""
    w, x, y, z = pose.q_wxyz
    s, c = math.sin(angle / 2), math.cos(angle / 2)
    a, b, d = (s if axis == k else 0.0 for k in range(3))
    turned = (w * c - x * a - y * b - z * d, w * a + x * c + y * d - z * b)
    return Pose(pose.p_m, (*turned, w * b - x * d + y * c + z * a, w * d + x * b - y * a + z * c))


def _assert_nothing_moves(bench: Bench) -> None:
    before = bench.last.view.q_cmd
    bench.run(0.5)
    assert bench.last.view.q_cmd == pytest.approx(before, abs=1e-6)
    assert bench.last.valves.valves == pytest.approx((0.0,) * 6, abs=1e-6)
    assert bench.state.motion.path is None


def test_a_tool_that_passes_straight_over_the_singularity_is_followed(bench: Bench) -> None:
    goal = _turned(bench.last.view.X_BT, 0, math.radians(-45.0))
    assert bench.refer(goal).reason is Reason.ACCEPTED
    begin = len(bench.outputs)
    bench.run(8.0)
    assert bench.last.view.motion_done
    assert bench.last.view.q_meas[4] > math.radians(15.0)
    lag = [math.dist(o.view.X_BT.p_m, o.view.X_BT_cmd.p_m) for o in bench.outputs[begin:]]
    assert max(lag) < 5e-3
    assert max(abs(o.view.q_meas[3]) for o in bench.outputs[begin:]) < math.radians(1.0)


def _pose_at(settings: ScanSettings, degrees: tuple[float, ...]) -> Pose:
    tool = tool_state(settings.table, np.radians(degrees))
    return Pose(tuple(tool.p_BT), tuple(tool.quaternion))


def test_a_tool_that_passes_beside_the_singularity_is_refused_before_a_joint_runs_out(
    settings: ScanSettings,
) -> None:
    """Between two samples of its way wrist 3 left its range, and the servo with it: 90.5° at 90.5."""
    bench = Bench(settings, tuple(np.radians((2.9, 47.0, -68.5, 89.4, -52.5, 79.7)))).enabled()
    R_BT = np.array(
        [[0.63842, -0.36260, 0.67892], [-0.76551, -0.20736, 0.60910], [-0.08007, -0.90859, -0.40995]]
    )
    goal = Pose((4.19083, 0.06496, 0.92851), tuple(quaternion_from_matrix(R_BT)))
    assert bench.refer(goal).reason in (Reason.SINGULAR, Reason.JOINT_LIMIT)
    _assert_nothing_moves(bench)


@pytest.mark.parametrize(
    ("begin_deg", "end_deg"),
    [
        ((-3.32, 47.6, -69.4, 70.13, 26.14, -83.68), (-2.56, 51.27, -70.29, 79.09, -20.67, -87.13)),
        ((-2.05, 46.97, -66.91, 70.74, -22.82, -80.89), (-7.35, 48.69, -69.45, 78.58, 16.32, -89.0)),
    ],
)
def test_a_joint_that_goes_on_while_damping_takes_hold_stays_in_its_range(
    settings: ScanSettings, begin_deg: tuple[float, ...], end_deg: tuple[float, ...]
) -> None:
    """Both ways were accepted, and wrist 3 was commanded 1.0 and 2.0° beyond its planned range: the second
    ended by a fault.
    """
    bench = Bench(settings, tuple(np.radians(begin_deg))).enabled()
    assert bench.refer(_pose_at(settings, end_deg)).reason in (Reason.SINGULAR, Reason.JOINT_LIMIT)
    _assert_nothing_moves(bench)


def test_what_is_accepted_near_the_singularity_is_followed_to_its_end(settings: ScanSettings) -> None:
    answers = []
    for swing in (0.0, 4.0, 32.0):
        bench = Bench(settings, tuple(np.radians((1.0, 47.0, -68.0, 55.0 + swing, -30.0, 70.0)))).enabled()
        answers.append(bench.refer(_pose_at(settings, (1.0, 47.0, -68.0, 55.0, 25.0, 70.0))).reason)
        if answers[-1] is Reason.ACCEPTED:
            bench.run(9.0)
            assert bench.last.view.motion_done
            assert bench.last.view.fault is FaultCode.NONE
            assert bench.last.view.q_meas[4] == pytest.approx(math.radians(25.0), abs=1e-2)
    assert answers[0] is Reason.ACCEPTED
    assert answers[-1] in (Reason.SINGULAR, Reason.JOINT_LIMIT)


def _defects(bench: Bench) -> dict[str, Pose]:
    here = bench.shifted(z=0.05)
    return {
        "sound": here,
        "half a metre": bench.shifted(z=0.5),
        "NaN": Pose((math.nan, 0.0, 1.0), here.q_wxyz),
        "norm 2": Pose(here.p_m, tuple(2.0 * c for c in here.q_wxyz)),  # type: ignore[arg-type]
        "1 km away": bench.shifted(z=1000.0),
        "above": bench.shifted(z=2.9)._replace(p_m=(bench.shifted().p_m[0], 0.0, 4.6)),
    }


@pytest.mark.parametrize(
    ("poses", "segment_s", "dwell_s", "answer"),
    [
        (["norm 2", "NaN"], 0.0, 0.0, Reason.NOT_UNIT_QUATERNION),
        (["NaN", "norm 2"], 0.0, 0.0, Reason.NOT_FINITE),
        (["sound", "norm 2"], math.nan, 0.0, Reason.NOT_UNIT_QUATERNION),
        (["sound"], 0.01, math.nan, Reason.NOT_FINITE),
        (["1 km away"], 0.01, 0.0, Reason.BAD_DURATION),
        (["1 km away"], 0.0, -1.0, Reason.BAD_DURATION),
        (["1 km away", "above"], 0.0, 0.0, Reason.TOO_FAR),
        (["half a metre", "above"], 0.5, 0.0, Reason.OUTSIDE_WORKSPACE),
        (["half a metre", "sound"], 0.5, 0.0, Reason.TOO_FAST),
        (["sound", "sound"], 300.0, 0.0, Reason.BAD_DURATION),
    ],
)
def test_the_content_is_judged_in_the_order_of_the_page(
    bench: Bench, poses: list[str], segment_s: float, dwell_s: float, answer: Reason
) -> None:
    known = _defects(bench)
    path = ReferencePath(9, tuple(known[name] for name in poses), segment_s, dwell_s)
    assert bench.step(path).acknowledgements[0].reason is answer
    _assert_nothing_moves(bench)


def test_a_jump_within_a_path_is_slow_enough(bench: Bench, config: ControllerConfig, arm: NominalArm) -> None:
    """Durations chosen by the controller keep every limit: Cartesian and joint, speed and acceleration."""
    first, second = bench.shifted(y=0.4, z=0.2), _turned(bench.shifted(y=-0.3, z=-0.2), 2, 0.5)
    assert (
        bench.step(ReferencePath(1, (first, second), 0.0, 0.0)).acknowledgements[0].reason is Reason.ACCEPTED
    )
    begin = len(bench.outputs)
    while not bench.last.view.motion_done:
        bench.step()
    dt_s = config.cycle_ms * 1e-3
    p = np.array([o.view.X_BT_cmd.p_m for o in bench.outputs[begin:]])
    v = np.diff(p, axis=0) / dt_s
    assert np.linalg.norm(v, axis=1).max() < 1.005 * config.motion.speed_m_s
    assert np.linalg.norm(np.diff(v, axis=0) / dt_s, axis=1).max() < 1.01 * config.motion.acceleration_m_s2
    q = np.array([o.view.q_cmd for o in bench.outputs[begin:]])
    speeds = np.abs(np.diff(q, axis=0)).max(axis=0) / dt_s
    assert np.all(speeds < 1.1 * np.radians([joint.speed_deg_s for joint in arm.joints]))
