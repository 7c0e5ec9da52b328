"""How well and how fast the odometry follows rendered walls, beside ORB-SLAM3 on the same pictures;
`make bench` prints the figures.
"""

import runpy
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.support.paths import ROOT
from tests.vision_pc.odometry.test_odometry import pair_at, poses
from tests.vision_pc.perception.test_markers import object_markers
from tests.vision_pc.rendering import Marker, facing, wall_texture
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception import intrinsics, look
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, FrameObservation, OdometryPose, StereoPair

pytestmark = [pytest.mark.usefixtures("one_core"), pytest.mark.bench, pytest.mark.timeout(900)]

FRAMES = 60
OFFSET_PX = (-0.3, 0.2)
LOOKS = 8  # pairs at rest before the path, from whose markers the right eye's offset is learnt


class Track(NamedTuple):
    """The poses that were valid, and the processor time of every frame, all threads, s."""

    poses: list[OdometryPose]
    spent_s: list[float]


class Case(NamedTuple):
    """A wall, and the limits: absolute trajectory error, scale, and time a frame."""

    z: float
    contrast: float
    noise: float
    offset: bool
    limit_mm: float
    limit_scale: float = 0.01


CASES = [
    Case(1.5, 1.0, 2.0, False, 0.2),
    Case(3.0, 1.0, 2.0, False, 0.2),
    Case(3.0, 0.2, 2.0, False, 0.5),
    Case(3.0, 0.2, 5.0, False, 1.5),
    Case(1.5, 1.0, 2.0, True, 0.6, limit_scale=0.002),
]


@pytest.fixture(scope="module")
def peer_module() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "examples/slam/orb_slam3.py"))


@pytest.fixture(scope="module")
def words(
    camera: CameraCalibration, peer_module: dict[str, Any], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """ORB-SLAM3's vocabulary, grown on another wall than those that are followed."""
    path = tmp_path_factory.mktemp("orb") / "words.txt"
    wall = wall_texture(9, 22.0)
    peer_module["vocabulary"]([pair_at(camera, wall, X).left for X in list(poses(FRAMES))[::4]], path)
    return path


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(f"{value:g}" for value in case[:4]))
def test_ahead_of_orb_slam3(
    camera: CameraCalibration,
    config: VisionConfig,
    peer_module: dict[str, Any],
    words: Path,
    case: Case,
    capfd: pytest.CaptureFixture[str],
) -> None:
    truly = intrinsics.with_offset(camera, *OFFSET_PX) if case.offset else camera
    markers = object_markers(facing(0.1, 0.0, case.z - 0.05, (0.0, 0.0, 0.0))) if case.offset else ()
    texture = 118.0 + case.contrast * (wall_texture(1, 22.0) - 118.0)
    true = list(poses(FRAMES))
    pairs = [shot(truly, texture, X, k, case, markers) for k, X in enumerate(true)]

    told = camera
    if case.offset:
        before = [shot(truly, texture, true[0], 1000 + k, case, markers) for k in range(LOOKS)]
        told = learnt(before, camera, config)
    ours = {"both eyes": follow(told, config, pairs)}
    peer = one_map(followed_by_peer(peer_module["OrbSlam3"](camera, words), pairs))
    capfd.readouterr()  # what the peer tells of itself
    with capfd.disabled():
        print(
            f"\nodometry at {case.z:g} m, contrast {case.contrast:g}, noise {case.noise:g}"
            + (f", right eye off by {OFFSET_PX[0]:g} px" if case.offset else "")
        )
        for name, followed in [*ours.items(), ("ORB-SLAM3", peer)]:
            error, scale = aligned_error(followed.poses, true)
            print(
                f"  {name}: {1e3 * error:.3f} mm rms, scale {100 * scale:+.3f} %, {len(followed.poses)} of"
                f" {FRAMES} frames, {milliseconds(followed):.1f} ms a frame (processor time, median)"
            )
        print(f"  limits: {case.limit_mm:g} mm, and the peer's error and time")
    for followed in ours.values():
        error, scale = aligned_error(followed.poses, true)
        assert len(followed.poses) == FRAMES
        assert 1e3 * error < case.limit_mm
        assert abs(scale) < case.limit_scale
        assert error < aligned_error(peer.poses, true)[0]
        assert milliseconds(followed) < milliseconds(peer)


def shot(
    camera: CameraCalibration, texture: Array, X_C0C: Array, k: int, case: Case, markers: tuple[Marker, ...]
) -> StereoPair:
    placed = tuple(marker._replace(X_CA=se3.inverse(X_C0C) @ marker.X_CA) for marker in markers)
    return pair_at(camera, texture, X_C0C, z=case.z, noise=case.noise, seed=k, markers=placed)


def learnt(pairs: list[StereoPair], camera: CameraCalibration, config: VisionConfig) -> CameraCalibration:
    """The camera with the right eye's offset as the markers in ``pairs`` tell it."""
    seen: FrameObservation | None = None
    for pair in pairs:
        seen = look.observe(pair, camera, config.markers, seen)
    assert seen is not None
    assert seen.offset is not None
    return intrinsics.with_offset(camera, seen.offset.x_px, seen.offset.y_px)


def follow(camera: CameraCalibration, config: VisionConfig, pairs: list[StereoPair]) -> Track:
    odometry, found, spent = StereoOdometry(camera, config.odometry), [], []
    for pair in pairs:
        began = time.process_time()
        pose = odometry.process(pair)
        spent.append(time.process_time() - began)
        if pose is not None:
            found.append(pose)
    return Track(found, spent)


def followed_by_peer(slam: Any, pairs: list[StereoPair]) -> Track:
    """ORB-SLAM3's poses of rectified ``pairs``, at 15 pairs a second."""
    poses, spent = [], []
    for k, pair in enumerate(pairs):
        began = time.process_time()
        pose = slam.track(pair, k / 15.0)
        time.sleep(0.05)  # its mapping runs beside, as it would between two pairs
        spent.append(time.process_time() - began)
        if pose is not None:
            poses.append(pose._replace(frame_id=k))
    slam.shutdown()
    return Track(poses, spent)


def one_map(followed: Track) -> Track:
    """The longest stretch without a loss: after one the peer begins a map of its own, elsewhere."""
    ids = [pose.frame_id for pose in followed.poses]
    stretches = np.split(np.arange(len(ids)), 1 + np.flatnonzero(np.diff(ids) != 1))
    longest = max(stretches, key=len)
    return followed._replace(poses=[followed.poses[k] for k in longest])


def milliseconds(followed: Track) -> float:
    return 1e3 * float(np.median(followed.spent_s))


def aligned_error(found: list[OdometryPose], true: list[Array]) -> tuple[float, float]:
    """RMS distance (m) after the best rigid alignment (Umeyama 1991), and what scale would still better
    it.
    """
    a = np.array([pose.X_C0C[:3, 3] for pose in found])
    b = np.array([true[pose.frame_id][:3, 3] for pose in found])
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    R = se3.nearest_rotation(b.T @ a)
    error = np.sqrt(np.mean(np.sum((b - a @ R.T) ** 2, axis=1)))
    return float(error), float((b * (a @ R.T)).sum() / (a * a).sum() - 1.0)
