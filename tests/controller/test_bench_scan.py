"""How long a scan takes, and its kinematics beside Pinocchio and plain numpy. Run with: make bench."""

import math

import numpy as np
import pinocchio as pin
import pytest

from controller.core.kinematics.denavit_hartenberg import JOINTS, LINKS
from controller.core.kinematics.rotations import Array
from controller.core.references.admission import admit
from controller.core.scan import scan
from controller.core.scan_types import ScanInput
from controller.core.servo.pose_servo import tool_state
from controller.core.settings import ScanSettings
from protocol.reference_messages import ReferencePath, StreamedPose
from protocol.session_events import StreamedPoseReceived
from tests.controller.kinematics.test_kinematics import START, drawn_arm
from tests.controller.obedient_plant import Bench

pytestmark = pytest.mark.bench


def _next_input(bench: Bench) -> ScanInput:
    """The input of the scan that would come next."""
    sensors = bench._exchange()
    return ScanInput(bench.now_ns + 5_000_000, bench.settings.cycle_s, sensors, (), True)


@pytest.mark.benchmark(group="scan")
def test_scan_in_motion(benchmark, settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    inputs = _next_input(bench)
    benchmark(scan, settings, bench.state, inputs)


@pytest.mark.benchmark(group="scan")
def test_scan_in_a_stream(benchmark, settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    inputs = _next_input(bench)
    benchmark(scan, settings, bench.state, inputs)


@pytest.mark.benchmark(group="scan")
def test_scan_with_a_streamed_reference(benchmark, settings: ScanSettings) -> None:
    """Judged, surveyed and planned anew: what a reference costs in the one scan that takes it."""
    bench = Bench(settings).streaming()
    inputs = _next_input(bench)
    number, now_ns = bench.last.view.stream_number + 1, inputs.now_ns
    twist = (0.0, 0.05, 0.0, 0.0, 0.0, 0.05)
    reference = StreamedPose(bench.last.view.motion_id, number, now_ns, bench.shifted(y=0.1, z=0.1), twist)
    inputs = inputs._replace(streamed=StreamedPoseReceived(reference, now_ns, now_ns))
    _, output = benchmark(scan, settings, bench.state, inputs)
    assert output.refusal is None


@pytest.mark.benchmark(group="scan")
def test_scan_disabled(benchmark, settings: ScanSettings) -> None:
    bench = Bench(settings)
    bench.run(0.1)
    inputs = _next_input(bench)
    benchmark(scan, settings, bench.state, inputs)


@pytest.mark.benchmark(group="admission")
def test_admission_of_24_waypoints(benchmark, settings: ScanSettings) -> None:
    bench = Bench(settings).enabled()
    path = ReferencePath(
        1, tuple(bench.shifted(y=0.02 * (k % 5), z=0.01 * k) for k in range(1, 25)), 0.0, 0.0
    )
    benchmark(admit, settings, bench.state.motion.desired, bench.state.watch.q_meas, path)


@pytest.mark.benchmark(group="kinematics and Jacobian")
def test_ours(benchmark, table: Array) -> None:
    benchmark(tool_state, table, START)


@pytest.mark.benchmark(group="kinematics and Jacobian")
def test_pinocchio(benchmark, table: Array) -> None:
    model, data, frame = drawn_arm()

    def peer() -> Array:
        pin.computeJointJacobians(model, data, START)
        pin.updateFramePlacement(model, data, frame)
        return pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)

    assert peer() == pytest.approx(tool_state(table, START).J_BT, abs=1e-9)
    benchmark(peer)


@pytest.mark.benchmark(group="kinematics and Jacobian")
def test_plain_numpy(benchmark, table: Array) -> None:
    def peer() -> tuple[Array, Array]:
        frames = [np.eye(4)]
        for i in range(LINKS):
            theta = table[i, 2] + (START[i] if i < JOINTS else 0.0)
            ca, sa, a, d = math.cos(table[i, 0]), math.sin(table[i, 0]), table[i, 1], table[i, 3]
            ct, st = math.cos(theta), math.sin(theta)
            link = np.array(
                [
                    [ct, -st * ca, st * sa, a * ct],
                    [st, ct * ca, -ct * sa, a * st],
                    [0.0, sa, ca, d],
                    [0.0, 0.0, 0.0, 1.0],
                ]
            )
            frames.append(frames[-1] @ link)
        axes = np.array([frame[:3, 2] for frame in frames[:JOINTS]])
        levers = np.array([frames[-1][:3, 3] - frame[:3, 3] for frame in frames[:JOINTS]])
        return frames[-1], np.vstack([np.cross(axes, levers).T, axes.T])

    assert peer()[1] == pytest.approx(tool_state(table, START).J_BT, abs=1e-12)
    benchmark(peer)
