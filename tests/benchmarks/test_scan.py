"""How long a scan takes, and its kinematics beside Pinocchio and plain numpy. Run with: make bench."""

import math
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from controller.config import ControllerConfig
from controller.core.kinematics.denavit_hartenberg import JOINTS, LINKS, dh_table
from controller.core.kinematics.rotations import Array
from controller.core.references.admission import admit
from controller.core.scan import scan
from controller.core.scan_types import ScanInput
from controller.core.servo.servo_step import tool_state
from controller.core.settings import ScanSettings, settings_from
from foundation.configuration import load
from nominal_arm.description import NominalArm
from protocol.reference_messages import ReferencePath, StreamedPose
from protocol.session_events import StreamedPoseReceived
from tests.controller.kinematics.test_kinematics import START, drawn_arm
from tests.controller.obedient_plant import Bench
from tests.support.paths import CONFIGS

pytestmark = pytest.mark.bench
ARM = load(NominalArm, CONFIGS / "arm.yaml")


@pytest.fixture
def settings() -> ScanSettings:
    return settings_from(ARM, load(ControllerConfig, CONFIGS / "controller.yaml"))


@pytest.fixture
def table() -> Array:
    return dh_table(ARM.dh)


def _next_input(bench: Bench) -> ScanInput:
    """The input of the scan that would come next."""
    sensors = bench._exchange()
    now_ns = bench.now_ns + 5_000_000
    return ScanInput(now_ns, now_ns, bench.settings.cycle_s, sensors, (), True)


def _with_reference(bench: Bench, inputs: ScanInput) -> ScanInput:
    """``inputs`` with a moving reference 0.14 m away."""
    number, now_ns = bench.last.view.stream_number + 1, inputs.now_ns
    twist = (0.0, 0.05, 0.0, 0.0, 0.0, 0.05)
    reference = StreamedPose(bench.last.view.motion_id, number, now_ns, bench.shifted(y=0.1, z=0.1), twist)
    return inputs._replace(streamed=StreamedPoseReceived(reference, now_ns, now_ns))


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


def plain_numpy(table: Array) -> tuple[Array, Array]:
    """Kinematics and Jacobian in plain numpy: also the yardstick of this machine."""
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


def test_no_scan_is_long_beside_plain_numpy(settings: ScanSettings, table: Array) -> None:
    """Medians, turn by turn in one run: one kinematics in numpy against whole scans."""
    moving, streaming = Bench(settings).moving(), Bench(settings).streaming()
    motion, stream = _next_input(moving), _next_input(streaming)
    referred = _with_reference(streaming, stream)
    work: dict[str, tuple[float, Callable[[], object]]] = {
        "plain numpy": (1.0, lambda: plain_numpy(table)),
        "scan in motion": (2.5, lambda: scan(settings, moving.state, motion)),
        "scan in a stream": (2.5, lambda: scan(settings, streaming.state, stream)),
        "scan with a streamed reference": (
            7.0,
            lambda: scan(settings, streaming.state, referred),
        ),
    }
    taken: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(500):
        for name, (_, run) in work.items():
            began_ns = time.perf_counter_ns()
            run()
            taken[name].append((time.perf_counter_ns() - began_ns) * 1e-3)
    medians = {name: float(np.median(times[50:])) for name, times in taken.items()}
    for name, median in medians.items():
        print(f"{name}: {median:.0f} us, {median / medians['plain numpy']:.2f} of plain numpy")
    for name, (most, _) in work.items():
        assert medians[name] <= most * medians["plain numpy"], name
