"""ORB-SLAM3 through `pyorbslam3` (GPL-3: no dependency, used where somebody installed it).

Its vocabulary is not in the wheel. Tracking without loops needs one only to bring descriptors of like kind
together, so one is grown here from the same walls: hierarchical k-medians over ORB descriptors, in DBoW2's
text form (Gálvez-López and Tardós 2012).
"""

import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vision_pc.core import se3
from vision_pc.core.types import CameraCalibration, OdometryPose, StereoPair

_BRANCHES, _LEVELS = 10, 5
_ROUNDS = 4

Descriptors = NDArray[np.uint8]

# The older of its two settings formats: the newer one crashes on rectified pairs.
_SETTINGS = """%YAML:1.0
Camera.type: "PinHole"
Camera.fx: {fx}
Camera.fy: {fy}
Camera.cx: {cx}
Camera.cy: {cy}
Camera.k1: 0.0
Camera.k2: 0.0
Camera.p1: 0.0
Camera.p2: 0.0
Camera.bf: {bf}
Camera.width: {width}
Camera.height: {height}
Camera.fps: 15.0
Camera.RGB: 1
ThDepth: 60.0
ORBextractor.nFeatures: 1200
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 0.9
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -1.8
Viewer.ViewpointF: 500.0
"""


def vocabulary(pictures: list[NDArray[np.uint8]], path: Path) -> None:
    """Write a vocabulary of the descriptors in ``pictures`` to ``path``."""
    orb = cv2.ORB.create(2000, fastThreshold=5)
    found = np.concatenate([orb.detectAndCompute(picture, None)[1] for picture in pictures])
    lines = [f"{_BRANCHES} {_LEVELS} 0 0"]
    _grow(found, 0, 1, lines, np.random.default_rng(1))
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _grow(
    descriptors: Descriptors, parent: int, level: int, lines: list[str], generator: np.random.Generator
) -> None:
    """Children of ``parent`` appended to ``lines``; a node's number is its line's."""
    centres, nearest = _medians(descriptors, generator)
    for k, centre in enumerate(centres):
        own = descriptors[nearest == k]
        leaf = level == _LEVELS or len(own) <= _BRANCHES
        lines.append(f"{parent} {int(leaf)} {' '.join(map(str, centre))} {1.0 if leaf else 0.0}")
        if not leaf:
            _grow(own, len(lines) - 1, level + 1, lines, generator)


def _medians(
    descriptors: Descriptors, generator: np.random.Generator
) -> tuple[Descriptors, NDArray[np.intp]]:
    """Centres (k, 32) under Hamming distance and whose each descriptor is; no centre is without any."""
    count = min(_BRANCHES, len(descriptors))
    centres = descriptors[generator.choice(len(descriptors), count, replace=False)]
    for _ in range(_ROUNDS):
        nearest = _nearest(descriptors, centres)
        bits = [np.unpackbits(descriptors[nearest == k], axis=1) for k in np.unique(nearest)]
        centres = np.array([np.packbits(2 * own.sum(axis=0) > len(own)) for own in bits])
    kept, nearest = np.unique(_nearest(descriptors, centres), return_inverse=True)
    return centres[kept], nearest


def _nearest(descriptors: Descriptors, centres: Descriptors) -> NDArray[np.intp]:
    return np.asarray(np.argmin(np.bitwise_count(descriptors[:, None] ^ centres[None]).sum(axis=2), axis=1))


class OrbSlam3:
    """ORB-SLAM3 on rectified pairs, one a process: its first camera stays for ever."""

    def __init__(self, camera: CameraCalibration, words: Path) -> None:
        from pyorbslam3 import Sensor, Slam

        K = camera.left.K
        with tempfile.TemporaryDirectory() as directory:
            settings = Path(directory) / "settings.yaml"
            settings.write_text(
                _SETTINGS.format(
                    fx=K[0, 0],
                    fy=K[1, 1],
                    cx=K[0, 2],
                    cy=K[1, 2],
                    bf=float(camera.right.X_CE[0, 3] * K[0, 0]),
                    width=camera.width,
                    height=camera.height,
                ),
                encoding="ascii",
            )
            self._slam = Slam(words, settings, Sensor.STEREO)

    def track(self, pair: StereoPair, time_s: float) -> OdometryPose | None:
        """The camera's pose at ``pair``, or None where it has none."""
        result = self._slam.track_stereo(pair.left, pair.right, time_s)
        if not result.pose_valid:
            return None
        X = se3.identity()
        X[:3] = np.asarray(result.pose_wc)[:3]
        points = int(result.num_tracked_points)
        return OdometryPose(pair.capture_ns, pair.frame_id, X, np.eye(6), points, 1.0, 0.0)

    def shutdown(self) -> None:
        """End its threads."""
        self._slam.shutdown()
