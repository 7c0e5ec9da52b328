"""Streamed references through the scan: limits kept at every scan, silence, refusals, what never resumes."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.kinematics.rotations import Array, conjugate, quaternion_product, vector_from_quaternion
from controller.core.settings import ScanSettings
from protocol.axes_group import Mode
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.pose import Pose
from protocol.process_image import CONTROL_ENABLE
from protocol.reference_messages import FLAG_SETTLED, FLAG_STREAMING, StreamRefused
from tests.controller.obedient_plant import Bench

ZERO = (0.0,) * 6
SLOWS_S, CLOSES_S, CYCLE_S = 0.076, 0.088, 0.005


def opened(settings: ScanSettings) -> Bench:
    """A bench with an open stream that no reference has come in yet."""
    bench = Bench(settings).enabled()
    bench.open_stream()
    return bench


def turned(pose: Pose, vector: Array) -> Pose:
    """``pose`` turned in B by a rotation vector."""
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle else vector
    turn = np.array([math.cos(angle / 2), *(math.sin(angle / 2) * axis)])
    w, x, y, z = quaternion_product(turn, np.array(pose.q_wxyz)).tolist()
    return pose._replace(q_wxyz=(w, x, y, z))


def streamed(
    bench: Bench, rate_hz: float, seconds: float, at: Callable[[float], Pose], twist: tuple[float, ...] = ZERO
) -> None:
    """References of ``at`` (seconds) at ``rate_hz``, every one of them followed; scans go on in between."""
    scans, sent = round(seconds / CYCLE_S), 0
    for k in range(scans):
        t = k * CYCLE_S
        if t * rate_hz >= sent:
            sent += 1
            assert bench.stream(bench.last.view.stream_number + 1, at(t), twist_ref=twist) is None
        else:
            bench.step()


def commanded(bench: Bench) -> Array:
    """Positions of the desired tool (n, 3), one a scan."""
    return np.array([output.view.X_BT_cmd.p_m for output in bench.outputs])


def turns(bench: Bench) -> Array:
    """Mean angular velocities of the desired tool (n − 1, 3), one between every two scans."""
    q = np.array([output.view.X_BT_cmd.q_wxyz for output in bench.outputs])
    steps = [vector_from_quaternion(quaternion_product(b, conjugate(a))) for a, b in pairwise(q)]
    return np.array(steps) / CYCLE_S


def longest(rows: Array) -> float:
    return float(np.linalg.norm(rows, axis=1).max())


@pytest.mark.parametrize("rate_hz", [15.0, 30.0, 60.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_limits_hold_at_every_scan_whatever_the_references_do(
    settings: ScanSettings, config: ControllerConfig, rate_hz: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    bench = opened(settings)
    home = bench.shifted()

    def wild(_: float) -> Pose:
        x, y, z = rng.uniform(-0.15, 0.15, 3).tolist()
        p = (home.p_m[0] + x, home.p_m[1] + y, home.p_m[2] + z)
        return turned(home._replace(p_m=p), rng.uniform(-0.1, 0.1, 3))

    streamed(bench, rate_hz, 4.0, wild)
    limits = config.streaming
    v = np.diff(commanded(bench), axis=0) / CYCLE_S
    a, j = np.diff(v, axis=0) / CYCLE_S, np.diff(v, n=2, axis=0) / CYCLE_S**2
    assert longest(v) <= limits.speed_m_s * (1.0 + 1e-6)
    assert longest(a) <= limits.acceleration_m_s2 * (1.0 + 1e-6)
    assert longest(j) <= limits.jerk_m_s3 * (1.0 + 1e-6)
    assert longest(j) > 0.5 * limits.jerk_m_s3  # they were asked for
    # The planner bounds the rotation vector to the goal; at these angles the turn differs by a few percent.
    w = turns(bench)
    b, c = np.diff(w, axis=0) / CYCLE_S, np.diff(w, n=2, axis=0) / CYCLE_S**2
    assert longest(w) <= math.radians(limits.turn_speed_deg_s)
    assert longest(b) <= 1.05 * math.radians(limits.turn_acceleration_deg_s2)
    assert longest(c) <= 1.05 * math.radians(limits.turn_jerk_deg_s3)
    joints = np.diff([output.view.q_cmd for output in bench.outputs], axis=0) / CYCLE_S
    assert (np.abs(joints) <= 1.05 * settings.planning.joint_speeds).all()


@pytest.mark.parametrize("rate_hz", [15.0, 30.0])
def test_a_moving_reference_is_followed_without_lag_and_without_ripple(
    settings: ScanSettings, rate_hz: float
) -> None:
    bench = opened(settings)
    home, speed = bench.shifted(), 0.08
    reference = lambda t: home._replace(p_m=(home.p_m[0], home.p_m[1] + speed * t, home.p_m[2]))  # noqa: E731
    before = len(bench.outputs)
    streamed(bench, rate_hz, 4.0, reference, (0.0, speed, 0.0, 0.0, 0.0, 0.0))
    y = commanded(bench)[before:, 1] - home.p_m[1]
    v = np.diff(y)[400:] / CYCLE_S
    # a scan's desired motion is that of its end: one cycle after the reference's instant
    lag_s = np.arange(len(y))[400:] * CYCLE_S - y[400:] / speed
    assert np.abs(lag_s).max() < 0.01
    assert np.abs(v - speed).max() < 0.01 * speed
    assert v.min() > 0.0


def test_a_reference_at_rest_is_reached_without_going_past_it(settings: ScanSettings) -> None:
    bench = opened(settings)
    goal = bench.shifted(y=0.3)
    streamed(bench, 30.0, 5.0, lambda t: goal)
    y = commanded(bench)[:, 1]
    assert y.max() <= goal.p_m[1] + 1e-9
    assert bench.last.view.X_BT_cmd.p_m == pytest.approx(goal.p_m, abs=1e-9)
    assert bench.last.view.X_BT_cmd.q_wxyz == pytest.approx(goal.q_wxyz, abs=1e-9)
    assert bench.last.view.group_state is GroupState.MOVING
    assert bench.last.view.flags & FLAG_STREAMING
    assert not bench.last.view.motion_done


def test_a_silent_stream_is_slowed_down_then_centred_and_latched(settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    speed = np.linalg.norm(np.diff(commanded(bench)[-2:], axis=0)) / CYCLE_S
    assert speed > 0.09
    begin = len(bench.outputs)
    fresh_ns = bench.state.stream.fresh_ns  # type: ignore[union-attr]
    while bench.last.view.group_state is GroupState.MOVING:
        bench.step()
    silent = np.array([1e-9 * (output.view.time_ns - fresh_ns) for output in bench.outputs[begin:]])
    speeds = np.linalg.norm(np.diff(commanded(bench)[begin - 1 :], axis=0), axis=1) / CYCLE_S
    assert speeds[silent <= SLOWS_S].min() > 0.9 * speed
    ramp = speeds[(silent > SLOWS_S) & (silent <= CLOSES_S)]
    assert len(ramp) >= 2
    assert (np.diff(ramp) < 0.0).all()
    assert CLOSES_S < silent[-1] <= CLOSES_S + CYCLE_S + 1e-9
    assert bench.last.valves.valves == ZERO
    assert not bench.last.valves.control & CONTROL_ENABLE
    assert bench.outputs[-2].valves.control & CONTROL_ENABLE
    assert (
        np.abs(bench.outputs[-2].valves.valves).max() < 0.2 * np.abs(bench.outputs[begin].valves.valves).max()
    )
    assert (bench.last.view.fault, bench.last.view.severity) == (FaultCode.REFERENCE_STALE, Severity.STOP)
    event = next(event for event in bench.last.events if event.name == "fault")
    assert event.value == pytest.approx(silent[-1])
    assert event.limit == pytest.approx(CLOSES_S)


def test_four_lost_in_a_row_at_60_hz_are_survived(settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    goal = bench.shifted(z=0.2)
    number = bench.last.view.stream_number
    for k in range(5):
        assert bench.stream(number + 1 + k, goal) is None
        before = len(bench.outputs)
        bench.run(0.08)  # the next one comes 85 ms after this one
        assert bench.state.fade > 0.0
    bench.stream(number + 9, goal)
    assert bench.last.view.group_state is GroupState.MOVING
    streamed(bench, 60.0, 0.3, lambda t: goal)
    assert bench.state.fade == 0.0
    # slowed down and speeded up again without a step: no speed changes by more than the ramp's steepest
    v = np.linalg.norm(np.diff(commanded(bench)[before:], axis=0), axis=1) / CYCLE_S
    steepest = 1.5 * v.max() * CYCLE_S / settings.streaming.ramp_s
    assert np.abs(np.diff(v)).max() <= steepest
    assert v[-1] > 0.9 * v.max()


def test_nothing_resumes_by_itself_and_a_new_stream_starts_from_rest(
    settings: ScanSettings, config: ControllerConfig
) -> None:
    bench = Bench(settings).streaming()
    old, goal = bench.last.view.motion_id, bench.shifted(z=0.2)
    bench.run(0.2)
    rest = bench.last.view.q_meas

    def refused(number: int, reason: Reason) -> None:
        refusal = bench.stream(number, goal, stream_id=old)
        assert refusal is not None
        assert (refusal.stream_id, refusal.number, refusal.reason) == (old, number, reason)

    refused(2000, Reason.ERROR_LATCHED)
    assert bench.command(CommandCode.START_STREAM) is Reason.ERROR_LATCHED
    assert bench.command(CommandCode.RESET) is Reason.ACCEPTED
    refused(2001, Reason.DISABLED)
    assert bench.command(CommandCode.ENABLE) is Reason.ACCEPTED
    refused(2002, Reason.NOT_STREAMING)
    assert bench.command(CommandCode.START_STREAM) is Reason.ACCEPTED
    refused(2003, Reason.NOT_STREAMING)  # the old stream's number
    bench.run(0.1)
    assert bench.last.view.q_meas == pytest.approx(rest, abs=1e-4)
    begin = len(bench.outputs)
    assert bench.stream(1, goal) is None
    streamed(bench, 30.0, 1.0, lambda t: goal)
    v = np.linalg.norm(np.diff(commanded(bench)[begin - 1 :], axis=0), axis=1) / CYCLE_S
    assert v[0] < 1e-3
    assert np.abs(np.diff(v)).max() / CYCLE_S <= config.streaming.acceleration_m_s2


def test_numbers_rise_and_wrap(settings: ScanSettings) -> None:
    bench = opened(settings)
    here = bench.shifted(y=0.01)
    assert bench.stream(2**32 - 2, here) is None
    assert bench.stream(2**32 - 1, here) is None
    assert bench.stream(0, here) is None
    assert bench.stream(5, here) is None
    for number in (5, 4, 0, 2**32 - 1, 5 + 2**31):
        refusal = bench.stream(number, bench.shifted(y=0.3))
        assert refusal is not None
        assert (refusal.reason, refusal.value, refusal.limit) == (Reason.OVERTAKEN, number, 5.0)
    assert bench.last.view.stream_number == 5


def edge(settings: ScanSettings) -> float:
    return settings.streaming.distance_m


REFUSED = [
    (lambda p, s: p._replace(p_m=(math.nan, 0.0, 0.0)), {}, Reason.NOT_FINITE, None),
    (lambda p, s: p._replace(p_m=(p.p_m[0], 1e-310, p.p_m[2])), {}, Reason.NOT_FINITE, None),
    (lambda p, s: p._replace(q_wxyz=(math.inf, 0.0, 0.0, 0.0)), {}, Reason.NOT_FINITE, None),
    (lambda p, s: p, {"twist_ref": (0.0, math.nan, 0.0, 0.0, 0.0, 0.0)}, Reason.NOT_FINITE, None),
    (lambda p, s: p, {"twist_ref": (0.0, 0.0, 0.0, 1e-310, 0.0, 0.0)}, Reason.NOT_FINITE, None),
    (
        lambda p, s: p._replace(q_wxyz=tuple(1.002 * q for q in p.q_wxyz)),
        {},
        Reason.NOT_UNIT_QUATERNION,
        1.002,
    ),
    (lambda p, s: moved(p, 1.001 * edge(s)), {}, Reason.TOO_FAR, 0.5005),
    (lambda p, s: turned(p, np.array([0.0, 0.0, 0.54])), {}, Reason.TOO_FAR, 0.54),
    (lambda p, s: p, {"age_s": 0.26}, Reason.STALE, 0.26),
    (lambda p, s: p, {"twist_ref": (0.0, 0.2, 0.0, 0.0, 0.0, 0.0)}, Reason.TOO_FAST, 0.2),
    (lambda p, s: p, {"twist_ref": (0.0, 0.0, 0.0, 0.0, 0.0, -0.2)}, Reason.TOO_FAST, 0.2),
    (lambda p, s: p, {"stream_id": 9_999}, Reason.NOT_STREAMING, 9999.0),
]


def moved(pose: Pose, y: float) -> Pose:
    return pose._replace(p_m=(pose.p_m[0], pose.p_m[1] + y, pose.p_m[2]))


@pytest.mark.parametrize(("spoil", "more", "reason", "value"), REFUSED)
def test_what_is_refused_changes_nothing(
    settings: ScanSettings,
    spoil: Callable[[Pose, ScanSettings], Pose],
    more: dict[str, object],
    reason: Reason,
    value: float | None,
) -> None:
    bench = opened(settings)
    assert bench.stream(1, bench.shifted(y=0.02)) is None
    stream, path = bench.state.stream, bench.state.motion.path
    at = Pose(*bench.last.view.X_BT_cmd)
    refusal = bench.stream(2, spoil(at, settings), **more)
    assert isinstance(refusal, StreamRefused)
    assert refusal.reason is reason
    if value is not None:
        assert refusal.value == pytest.approx(value, abs=2e-3)
    assert bench.state.stream is stream
    assert bench.state.motion.path is path
    assert ("streamed", reason.name) in [event[:2] for event in bench.last.events]


def test_just_inside_the_limits_is_followed(settings: ScanSettings) -> None:
    bench = opened(settings)
    here = bench.shifted()
    assert bench.stream(1, moved(here, 0.999 * edge(settings)), age_s=0.24) is None
    assert bench.stream(2, turned(here, np.array([0.0, 0.0, 0.52]))) is None
    assert bench.stream(3, here, twist_ref=(0.0, 0.11, 0.0, 0.0, 0.0, 0.09)) is None
    doubled = here._replace(q_wxyz=tuple(-q for q in here.q_wxyz))
    assert bench.stream(4, doubled) is None
    assert bench.state.motion.path is not None
    bench.run(0.06)


@pytest.mark.parametrize(
    ("way", "reason"),
    [((1.0, 0.0, 0.0), Reason.OUTSIDE_WORKSPACE), ((0.0, 0.0, -1.0), Reason.OUTSIDE_WORKSPACE)],
)
def test_references_that_lead_out_are_refused_on_the_way(
    settings: ScanSettings, way: tuple[float, float, float], reason: Reason
) -> None:
    bench = opened(settings)
    for number in range(1, 4000):
        x, y, z = bench.last.view.X_BT_cmd.p_m
        ahead = Pose((x + 0.1 * way[0], y + 0.1 * way[1], z + 0.1 * way[2]), bench.last.view.X_BT_cmd.q_wxyz)
        refusal = bench.stream(number, ahead)
        if refusal is not None:
            break
    assert refusal is not None
    assert refusal.reason in (reason, Reason.UNREACHABLE, Reason.JOINT_LIMIT, Reason.SINGULAR)
    assert bench.last.view.group_state is GroupState.MOVING
    bench.run(0.2)
    assert bench.last.view.fault is FaultCode.REFERENCE_STALE  # and not a limit that was run into


def test_refused_references_do_not_keep_a_stream_alive(settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    number = bench.last.view.stream_number
    nan = bench.shifted()._replace(p_m=(math.nan, 0.0, 0.0))
    for k in range(1, 25):
        bench.stream(number + k, nan)
    assert bench.last.view.fault is FaultCode.REFERENCE_STALE


def test_the_end_of_a_stream_leads_to_its_newest_reference(settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    goal = bench.shifted(z=0.1)
    stream_id = bench.last.view.motion_id
    assert bench.stream(bench.last.view.stream_number + 1, goal) is None
    assert bench.command(CommandCode.END_STREAM) is Reason.ACCEPTED
    assert not bench.last.view.flags & FLAG_STREAMING
    refusal = bench.stream(3000, bench.shifted())
    assert refusal is not None
    assert refusal.reason is Reason.NOT_STREAMING
    bench.run(6.0)
    view = bench.last.view
    assert (view.motion_id, view.motion_done) == (stream_id, True)
    assert view.flags & FLAG_SETTLED
    assert view.X_BT_cmd.p_m == pytest.approx(goal.p_m, abs=1e-9)
    assert view.group_state is GroupState.STANDBY


def test_a_stream_without_references_ends_at_once(settings: ScanSettings) -> None:
    bench = opened(settings)
    assert bench.command(CommandCode.END_STREAM) is Reason.ACCEPTED
    assert bench.last.view.group_state is GroupState.STANDBY
    assert bench.last.view.motion_done


def test_the_end_of_a_moving_reference_comes_to_rest(settings: ScanSettings) -> None:
    bench = opened(settings)
    home = bench.shifted()
    streamed(bench, 30.0, 1.5, lambda t: moved(home, 0.08 * t), (0.0, 0.08, 0.0, 0.0, 0.0, 0.0))
    last = bench.state.stream.goal.p  # type: ignore[union-attr]
    assert bench.command(CommandCode.END_STREAM) is Reason.ACCEPTED
    bench.run(4.0)
    assert bench.last.view.motion_done
    assert bench.last.view.X_BT_cmd.p_m == pytest.approx(last.tolist(), abs=1e-9)


def test_a_stop_ends_a_stream(settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    number, goal = bench.last.view.stream_number + 1, bench.shifted(z=0.2)
    assert bench.command(CommandCode.STOP) is Reason.ACCEPTED
    refusal = bench.stream(number, goal)
    assert refusal is not None
    assert refusal.reason is Reason.STOPPING
    bench.run(2.0)
    assert bench.last.view.group_state is GroupState.STANDBY
    assert not bench.last.view.motion_done
    refusal = bench.stream(number + 1, goal)
    assert refusal is not None
    assert refusal.reason is Reason.NOT_STREAMING


def test_the_first_reference_is_waited_for_at_rest(settings: ScanSettings) -> None:
    bench = opened(settings)
    held = bench.last.view.X_BT_cmd
    bench.run(settings.streaming.first_s - 0.02)
    assert bench.last.view.group_state is GroupState.MOVING
    assert bench.last.view.X_BT_cmd == held
    bench.run(0.03)
    assert bench.last.view.fault is FaultCode.REFERENCE_STALE


def test_a_reference_outside_any_stream_is_told_the_id_it_named(settings: ScanSettings) -> None:
    bench = Bench(settings).enabled()
    refusal = bench.stream(1, bench.shifted(), stream_id=4711)
    assert refusal is not None
    assert (refusal.reason, refusal.value, refusal.limit) == (Reason.NOT_STREAMING, 4711.0, 0.0)


def test_the_end_of_the_session_closes_its_stream_to_the_next_one(settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    number, goal = bench.last.view.stream_number + 1, bench.shifted(z=0.2)
    bench.link_alive = False
    bench.step()
    bench.link_alive = True
    refusal = bench.stream(number, goal)
    assert refusal is not None
    assert refusal.reason is Reason.NOT_STREAMING
    assert bench.command(CommandCode.END_STREAM) is Reason.NOT_STREAMING
    bench.run(0.1)
    assert bench.last.view.fault is FaultCode.REFERENCE_STALE
    assert bench.last.valves.valves == ZERO


def test_supervision_goes_on_in_a_stream(settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    number, goal = bench.last.view.stream_number, bench.shifted(z=0.2)
    bench.stuck = True
    for k in range(1, 200):
        bench.stream(number + k, goal)
        if bench.last.view.fault is not FaultCode.NONE:
            break
    assert bench.last.view.fault in (FaultCode.FOLLOWING_ERROR, FaultCode.ENCODER_STUCK)
    assert bench.state.mode is Mode.ERROR_HELD
    assert bench.state.stream is None


def test_the_same_references_give_the_same_bits(settings: ScanSettings) -> None:
    def outputs() -> list[object]:
        bench = opened(settings)
        rng = np.random.default_rng(5)
        streamed(bench, 30.0, 2.0, lambda t: turned(bench.shifted(y=0.1), rng.uniform(-0.1, 0.1, 3)))
        return [(output.valves, output.view) for output in bench.outputs]

    assert outputs() == outputs()
