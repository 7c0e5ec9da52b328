"""Which motion is believed: depths known badly put all of their points off, a slow thing but some."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry.frame import Frame
from vision_pc.core.odometry.keyframes.keyframe import Keyframe
from vision_pc.core.odometry.keyframes.keyframe_map import HeldViews, KeyframeMap
from vision_pc.core.odometry.motion_choice import FoundPoints, MotionChoice, SeenMotion
from vision_pc.core.odometry.motion_prior import Foreseen, MotionPrior
from vision_pc.core.perception import intrinsics
from vision_pc.core.types import CameraCalibration

ASIDE = se3.transform(np.eye(3), (1.2, 0.0, 0.0))  # ten bases: a tenth of a pixel of disparity is a pixel
OFF_PX, THEIRS, COUNT = 3.5, 60, 200


class Shown:
    """The ids of points, in place of a keyframe: nothing else of it is asked where motions are foreseen."""

    def __init__(self, ids: np.ndarray) -> None:
        self.ids = ids


def numbered(frame_id: int) -> Frame:
    """A pair of which only the number is asked."""
    return cast("Frame", SimpleNamespace(pair=SimpleNamespace(frame_id=frame_id)))


@pytest.mark.parametrize(("pairs_later", "believed"), [(1, False), (6, False), (7, True)])
def test_what_nobody_foresaw_so_soon_after_a_second_motion_may_be_that_one(
    camera: CameraCalibration,
    config: VisionConfig,
    monkeypatch: pytest.MonkeyPatch,
    pairs_later: int,
    believed: bool,
) -> None:
    known = KeyframeMap(camera, 0.2)
    x, y = np.random.default_rng(3).uniform((-0.6, -0.6), (0.6, 0.6), (COUNT, 2)).T
    ids = known.add_points(se3.identity(), np.column_stack([x, y, np.full(COUNT, 2.0)]), 0.1)
    shown = cast("Keyframe", Shown(ids))
    pixels = intrinsics.project(camera.left, known.points[ids])
    choice = MotionChoice(camera, config.odometry_of_recordings, known, doubted=False)
    monkeypatch.setattr(choice, "_misses", lambda *asked: False)  # it is most of what should be seen
    still = Foreseen(MotionPrior(se3.identity(), 3.0))
    two = pixels + np.where(np.arange(COUNT) < THEIRS, 60.0, 0.0)[:, None] * (1.0, 0.0)
    first = choice.chosen(numbered(1), FoundPoints(shown, shown, two), se3.identity(), still)
    assert isinstance(first, SeenMotion)
    assert first.moving.sum() == THEIRS
    all_aside = FoundPoints(shown, shown, pixels + np.array([60.0, 0.0]))
    later = choice.chosen(numbered(1 + pairs_later), all_aside, se3.identity(), still)
    assert isinstance(later, SeenMotion) if believed else later == "sudden_motion"


@pytest.mark.parametrize(("known_well", "moves"), [(0, False), (20, True)])
def test_points_that_other_depths_put_right_are_a_second_motion_unless_all_are(
    camera: CameraCalibration, config: VisionConfig, known_well: int, moves: bool
) -> None:
    known = KeyframeMap(camera, 0.2)
    x, y = np.random.default_rng(3).uniform((0.4, -0.6), (1.6, 0.6), (COUNT, 2)).T
    points = np.column_stack([x, y, np.full(COUNT, 2.0)])
    ids = known.add_points(se3.identity(), points, 0.1)
    learnt = ids[:known_well]
    for _ in range(9):
        still = np.zeros((2, known_well, 2))
        by_depth = known.sensitivity(learnt, se3.inverse(ASIDE))
        known.update(learnt, HeldViews(still, np.ones((2, known_well)), by_depth), 0.1, still)
    pixels = intrinsics.project(camera.left, se3.apply(se3.inverse(ASIDE), points))
    pixels[:THEIRS, 0] += OFF_PX
    choice = MotionChoice(camera, config.odometry_of_recordings, known, doubted=False)
    shown = cast("Keyframe", Shown(ids))
    tracked, foreseen = FoundPoints(shown, shown, pixels), Foreseen(MotionPrior(ASIDE, 50.0))
    found = choice.chosen(numbered(1), tracked, ASIDE, foreseen)
    if moves:
        assert found == "two_motions"
    else:
        assert isinstance(found, SeenMotion)
        assert found.inliers[:THEIRS].mean() < 0.1
        assert found.inliers[THEIRS:].mean() > 0.9
