"""Streamed references through the scan: limits kept at every scan, silence, what never resumes."""

import math

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.settings import ScanSettings
from protocol.axes_group import Mode
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.pose import Pose
from protocol.process_image import CONTROL_ENABLE
from tests.controller.obedient_plant import Bench
from tests.controller.streamed import (
    CLOSES_S,
    CYCLE_S,
    SLOWS_S,
    ZERO,
    commanded,
    longest,
    opened,
    streamed,
    turned,
    turns,
)


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


def test_the_first_reference_is_waited_for_at_rest(settings: ScanSettings) -> None:
    bench = opened(settings)
    held = bench.last.view.X_BT_cmd
    bench.run(settings.streaming.first_s - 0.02)
    assert bench.last.view.group_state is GroupState.MOVING
    assert bench.last.view.X_BT_cmd == held
    bench.run(0.03)
    assert bench.last.view.fault is FaultCode.REFERENCE_STALE


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
