"""Two real stereo sequences with truth, which are not part of the repository, and what tests make of them.

``drive``: KITTI odometry 06, pictures 0 to 50. ``room``: EuRoC V1_01, its first 95 pairs.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares

from protocol.errors import RequestRefused
from testbed.hand_eye.trajectories import load_tum
from tests.support.recorded_sets import data_directory
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry.segments import SegmentedOdometry
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, Image, OdometryPose, StereoPair
from vision_pc.shell.cameras.grey_files import read_grey
from vision_pc.shell.cameras.sequence import SequenceResult, follow_pairs
from vision_pc.shell.cameras.sequence_calibration import recorded_camera

MOVER_STEP_PX, MOVER_DISPARITY_PX = 9, 60
# What the truth itself is known to, m and rad. Drive: 5 cm (Geiger et al. 2012); on all axes the 0.1° that
# the RT 3003's data sheet has for heading (0.03° for the others: with that a drive's NEES is 12, not 4.4).
# Room: 1 mm (Burri et al. 2016); turns as its poses wander by while the pictures stand still.
TRUTH_STD = {"drive": np.repeat([0.05, np.radians(0.1)], 3), "room": np.repeat([1e-3, 2e-3], 3)}


class Sequence(NamedTuple):
    """Pairs, the true poses (n, 4, 4) of their left eyes, and the rectified camera."""

    name: str
    pairs: list[StereoPair]
    true: Array
    camera: CameraCalibration

    def chosen(self, part: slice) -> "Sequence":
        """Some of the pairs, at the times of the first ones where they are turned round."""
        pairs = self.pairs[part]
        times = sorted(pair.capture_ns for pair in pairs)
        timed = [
            pair._replace(capture_ns=at, frame_id=k)
            for k, (pair, at) in enumerate(zip(pairs, times, strict=True))
        ]
        return self._replace(pairs=timed, true=self.true[part])

    def changed(self, change: Callable[[int, StereoPair], StereoPair]) -> "Sequence":
        """With each pair as ``change`` makes it of its number and itself."""
        return self._replace(pairs=[change(k, pair) for k, pair in enumerate(self.pairs)])


class Judged(NamedTuple):
    """The longest map against the truth: mean error² over variance of six numbers, and how many of its
    ``poses`` are within 3 σ in every one; the worst place of any map, m from where its first pose puts it,
    and in σ after alignment.
    """

    nees: float
    within: int
    poses: int
    worst_m: float
    worst_sigmas: float


@lru_cache(maxsize=2)
def sequence(name: str) -> Sequence:
    """``drive`` or ``room``. Raises RequestRefused (``refused.data_absent``) where it is not there."""
    folder = data_directory() / "sequences" / name
    if not folder.is_dir():
        raise RequestRefused("refused.data_absent", f"no sequence at {folder}")
    times_s, true = load_tum(folder / "truth.tum")
    files = [sorted((folder / eye).glob("*.png")) for eye in ("left", "right")]
    pairs = [
        StereoPair(read_grey(left), read_grey(right), round(1e9 * at), k)
        for k, (left, right, at) in enumerate(zip(*files, times_s, strict=True))
    ]
    calibration = folder / ("calib.txt" if name == "drive" else "calib.yaml")
    return Sequence(name, pairs, true, recorded_camera(calibration, pairs[0]).camera)


def eyes(change: Callable[[Image], Image]) -> Callable[[int, StereoPair], StereoPair]:
    """The same ``change`` of both pictures."""
    return lambda _, pair: pair._replace(left=change(pair.left), right=change(pair.right))


def blurred(image: Image) -> Image:
    """As by a motion of 15 px along the rows."""
    return np.asarray(cv2.filter2D(image, -1, np.full((1, 15), 1.0 / 15.0, np.float32)), dtype=np.uint8)


def dim(image: Image) -> Image:
    """With 6 % of the light."""
    return np.rint(0.06 * image).astype(np.uint8)


def mover(share: float, texture: Image) -> Callable[[int, StereoPair], StereoPair]:
    """A thing with a ``texture`` of its own over a ``share`` of the width, going by 9 px a picture."""

    def change(k: int, pair: StereoPair) -> StereoPair:
        height, width = pair.left.shape
        wide = np.asarray(cv2.resize(texture, (2 * width + 1000, height)), dtype=np.uint8)
        edge, first = int(share * width), MOVER_STEP_PX * k
        left, right = pair.left.copy(), pair.right.copy()
        left[:, :edge] = wide[:, first : first + edge]
        right[:, :edge] = wide[:, first + MOVER_DISPARITY_PX : first + MOVER_DISPARITY_PX + edge]
        return pair._replace(left=left, right=right)

    return change


def followed(shown: Sequence, config: VisionConfig) -> SequenceResult:
    """What odometry finds in ``shown``."""
    return follow_pairs(
        lambda: shown.pairs, lambda _: SegmentedOdometry(shown.camera, config.odometry_of_recordings)
    )


def judged(result: SequenceResult, shown: Sequence) -> Judged:
    """``result`` against the truth, in which its own errors count."""
    maps: dict[int, list[tuple[OdometryPose, Array]]] = {}
    for record, true in zip(result.records, shown.true, strict=True):
        if record.pose is not None and record.segment is not None:
            maps.setdefault(record.segment, []).append((record.pose, true))
    variance = TRUTH_STD[shown.name] ** 2
    worst_m = worst_sigmas = 0.0
    for located in maps.values():
        start = located[0][0].X_C0C @ se3.inverse(located[0][1])
        for pose, true in located[1:]:
            off = pose.X_C0C[:3, 3] - (start @ true)[:3, 3]
            worst_m = max(worst_m, float(np.linalg.norm(off)))
        errors = _aligned(located, variance)
        worst_sigmas = max(worst_sigmas, float(np.abs(errors[:, :3]).max()))
    longest = max(maps.values(), key=len)
    errors = _aligned(longest, variance)
    covariances = [pose.covariance + np.diag(variance) for pose, _ in longest]
    scaled = [np.sqrt(np.diag(C)) for C in covariances]
    nees = [
        float((e * s) @ np.linalg.solve(C, e * s))
        for e, s, C in zip(errors, scaled, covariances, strict=True)
    ]
    within = int((np.abs(errors) < 3.0).all(axis=1).sum())
    return Judged(float(np.mean(nees)), within, len(longest), worst_m, worst_sigmas)


def _aligned(located: list[tuple[OdometryPose, Array]], variance: Array) -> Array:
    """Errors (n, 6) in σ after the rigid alignment that makes them least likely to be noticed."""
    covariances = [pose.covariance + np.diag(variance) for pose, _ in located]
    roots = [np.linalg.cholesky(np.linalg.inv(C)).T for C in covariances]
    middle, true = located[len(located) // 2]
    place = middle.X_C0C[:3, 3]

    def errors(x: Array) -> Array:
        R = se3.exp_so3(x[3:])
        W = se3.transform(R, x[:3] + place - R @ place) @ middle.X_C0C @ se3.inverse(true)
        found = []
        for pose, at in located:
            X = W @ at
            turn = se3.log_so3(pose.X_C0C[:3, :3] @ X[:3, :3].T)
            found.append(np.concatenate([pose.X_C0C[:3, 3] - X[:3, 3], turn]))
        return np.array(found)

    best = least_squares(
        lambda x: np.concatenate([root @ e for root, e in zip(roots, errors(x), strict=True)]), np.zeros(6)
    ).x
    return errors(best) / np.sqrt([np.diag(C) for C in covariances])
