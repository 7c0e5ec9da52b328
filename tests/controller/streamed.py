"""What tests of streamed references share: an open stream, references fed to it, what was commanded."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from controller.core.kinematics.rotations import Array, conjugate, quaternion_product, vector_from_quaternion
from controller.core.settings import ScanSettings
from protocol.pose import Pose
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


def longest(rows: Array) -> float:
    return float(np.linalg.norm(rows, axis=1).max())


def turns(bench: Bench) -> Array:
    """Mean angular velocities of the desired tool (n − 1, 3), one between every two scans."""
    q = np.array([output.view.X_BT_cmd.q_wxyz for output in bench.outputs])
    steps = [vector_from_quaternion(quaternion_product(b, conjugate(a))) for a, b in pairwise(q)]
    return np.array(steps) / CYCLE_S
