"""Streamed references through the scan: limits kept at every scan, silence, what never resumes."""

import math

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.references.streaming import pace
from controller.core.settings import ScanSettings
from protocol.axes_group import Mode
from protocol.faults import FaultCode
from protocol.pose import Pose
from tests.controller.obedient_plant import Bench
from tests.controller.streamed import (
    CYCLE_S,
    commanded,
    longest,
    opened,
    streamed,
    turned,
    turns,
)


@pytest.mark.parametrize(("fade", "rate"), [(0.0, 1.0), (0.25, 0.84375), (0.5, 0.5), (1.0, 0.0)])
def test_the_pace_falls_smoothly_from_full_to_none(fade: float, rate: float) -> None:
    assert pace(fade) == pytest.approx(rate, abs=1e-15)


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
