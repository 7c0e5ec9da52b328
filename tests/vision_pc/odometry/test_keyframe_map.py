"""What a map of keyframes keeps in order when it forgets some of them."""

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import Keyframe
from vision_pc.core.odometry.keyframes.keyframe_map import KeyframeMap
from vision_pc.core.odometry.keyframes.templates import Templates
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

POINTS = np.array([[0.1, 0.0, 2.0], [-0.2, 0.1, 3.0]])


def grown(known: KeyframeMap, x: float, points: Array = POINTS) -> Keyframe:
    """The next keyframe of ``known``, at ``x`` m to the right, and the first to show ``points`` in C."""
    number, X_C0C = known.next_number, se3.transform(np.eye(3), (x, 0.0, 0.0))
    ids = known.add_points(X_C0C, points, 0.1)
    picture = np.zeros((8, 8), dtype=np.uint8)
    rays: Array = points[:, :2] / points[:, 2:]
    known.keyframes.append(
        Keyframe(
            number,
            X_C0C,
            picture,
            picture,
            ids,
            rays,
            rays,
            np.zeros((2, 3)),
            Templates(picture, rays, 3),
            np.arange(len(ids)),
        )
    )
    return known.keyframes[-1]


def test_the_number_of_a_forgotten_keyframe_is_given_to_no_other(camera: CameraCalibration) -> None:
    """Back where it began, a full map forgets the newest keyframe: the next one once had its number, and so
    its place in what is told of errors.
    """
    known = KeyframeMap(camera, 0.2)
    first, _, newest = (grown(known, x) for x in (0.0, 1.0, 2.0))
    known.forget(newest)
    after = grown(known, 0.1)
    assert (first.number, newest.number, after.number) == (0, 2, 3)
    assert known.shown_by(newest.ids).tolist() == [2, 2]
    assert known.shown_by(after.ids).tolist() == [3, 3]
    known.forget(first)
    assert known.next_number == 4
