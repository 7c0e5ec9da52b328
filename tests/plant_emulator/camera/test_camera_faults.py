"""Frames lost, repeated, blind, markers covered, to pixel and stamp."""

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from plant_emulator.core.camera.exposures import STILL, CameraView, Capture, Exposures, Shot
from plant_emulator.core.camera.stereo_camera import LEFT, RIGHT
from plant_emulator.core.faults.kinds import (
    CameraBlind,
    CameraFrozen,
    Fault,
    FramesDropped,
    MarkerCovered,
    Side,
    SupplyLost,
)
from plant_emulator.core.mechanics.geometry import transform
from plant_emulator.core.plant import Plant
from protocol.errors import RequestRefused
from tests.plant_emulator.camera.camera_world import clean_camera, scene_config, shipped_camera, start_view
from tests.plant_emulator.camera.test_stereo_camera import seen_ids
from tests.plant_emulator.plant_world import Driver, plant_config


def exposures(seed: int = 7) -> Exposures:
    """Exposures of the shipped camera."""
    return Exposures(scene_config().camera, seed)


def captures(count: int) -> list[Capture]:
    """Captures of an arm that moves sideways by a centimetre from one to the next."""
    view = start_view(clean_camera().scene)
    step = transform(np.eye(3), np.array([0.01, 0.0, 0.0]))
    taken = []
    for number in range(1, count + 1):
        taken.append(Capture(number, number * 100, view, STILL))
        view = CameraView(view.X_WC @ step, view.X_WM @ step)
    return taken


def shots(faults: Sequence[Sequence[Fault]]) -> list[Shot]:
    """The shots of as many captures as there are entries in ``faults``."""
    source = exposures()
    return [source.shot(capture, now) for capture, now in zip(captures(len(faults)), faults, strict=True)]


def test_a_healthy_camera_shows_every_capture_under_its_own_stamps() -> None:
    for shot, capture in zip(shots([[]] * 5), captures(5), strict=True):
        assert (shot.frame_id, shot.capture_ns) == capture[:2]
        assert shot.shown.frame_id == capture.frame_id
        assert shot.delivered
        assert shot.blind is None
        assert not shot.covers


def test_frames_are_dropped_by_seed_and_number() -> None:
    def delivered(seed: int, faults: list[Fault]) -> list[bool]:
        source = exposures(seed)
        return [source.shot(c, faults).delivered for c in captures(2000)]

    dropping: list[Fault] = [FramesDropped(share=0.2)]
    assert np.mean(delivered(7, dropping)) == pytest.approx(0.8, abs=0.03)
    assert delivered(7, dropping) == delivered(7, dropping) != delivered(8, dropping)
    assert not any(delivered(7, [FramesDropped()]))
    assert all(delivered(7, [SupplyLost()]))


def test_a_frozen_camera_repeats_the_last_picture_under_new_stamps() -> None:
    """As a driver does that stamps a stale buffer anew: the numbers go on, only the content betrays it."""
    frozen: list[Fault] = [CameraFrozen()]
    taken = shots([[], [], frozen, frozen, frozen, []])
    assert [shot.frame_id for shot in taken] == [1, 2, 3, 4, 5, 6]
    assert [shot.capture_ns for shot in taken] == [100, 200, 300, 400, 500, 600]
    assert [shot.shown.frame_id for shot in taken] == [1, 2, 2, 2, 2, 6]
    pictures = [shipped_camera().take(shot) for shot in taken[1:4]]
    for eye in (LEFT, RIGHT):
        assert np.array_equal(pictures[1][eye], pictures[0][eye])  # its noise too
        assert np.array_equal(pictures[2][eye], pictures[0][eye])
    assert not np.array_equal(shipped_camera().take(taken[5])[LEFT], pictures[0][LEFT])


def test_a_frozen_camera_may_hold_its_stamps_too() -> None:
    frozen: list[Fault] = [CameraFrozen(stamps="hold")]
    assert [shot[:2] for shot in shots([[], frozen, frozen, []])] == [(1, 100), (1, 100), (1, 100), (4, 400)]


def test_a_camera_frozen_from_the_start_shows_its_first_picture() -> None:
    frozen: list[Fault] = [CameraFrozen()]
    assert [shot.shown.frame_id for shot in shots([frozen, frozen, frozen])] == [1, 1, 1]


def test_what_a_camera_could_not_see_when_it_froze_it_never_sees() -> None:
    covered = MarkerCovered(marker_id=3)
    taken = shots([[covered], [covered, CameraFrozen()], [CameraFrozen()], []])
    assert [shot.covers for shot in taken] == [(covered,), (covered,), (covered,), ()]


@pytest.mark.parametrize("grey", [0, 90, 255])
def test_a_blind_camera_sees_one_level_and_its_own_noise(grey: int) -> None:
    (shot,) = shots([[CameraBlind(grey=grey)]])
    left, right = shipped_camera().take(shot)
    assert left.shape == (720, 1280)
    assert seen_ids(left) == set()
    if grey == 90:
        assert left.mean() == pytest.approx(90.0, abs=0.1)
        assert left.std() == pytest.approx(shipped_camera().config.noise_grey, rel=0.05)
        assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.01  # each eye has its own
    assert np.abs(left.astype(int) - grey).max() < 15


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_a_cover_lies_over_its_share_from_its_side_and_nowhere_else(side: Side) -> None:
    eyes = clean_camera()
    plain, covered = shots([[], [MarkerCovered(marker_id=3, share=0.3, side=side, grey=0)]])
    covered = covered._replace(shown=plain.shown)
    changed = eyes.take(covered)[LEFT] != eyes.take(plain)[LEFT]
    marker = scene_config().object_of_interest.markers[2]
    half = marker.side_m / 2.0 * (1.0 + marker.print_scale_error) + marker.quiet_zone_m
    inner = half * (1.0 - 2.0 * 0.3)
    edge_x, edge_y = {
        "left": ((-half, -inner), (-half, half)), "right": ((inner, half), (-half, half)),
        "top": ((-half, half), (inner, half)), "bottom": ((-half, half), (-half, -inner)),
    }[side]  # fmt: skip
    corners = np.array([[x, y, 0.0] for x, y in ((edge_x[0], edge_y[0]), (edge_x[1], edge_y[0]),
                                                (edge_x[1], edge_y[1]), (edge_x[0], edge_y[1]))])  # fmt: skip
    X_WO = eyes.scene.mounts.X_WO
    in_O = corners + np.array([*marker.centre_m, 0.0])
    image, _ = eyes.project(plain.shown.view.X_WC, in_O @ X_WO[:3, :3].T + X_WO[:3, 3])
    mask = cv2.fillConvexPoly(np.zeros(changed.shape, np.uint8), np.rint(image).astype(np.int32), 1)
    assert not changed[cv2.dilate(mask, np.ones((5, 5), np.uint8)) == 0].any()
    assert changed[cv2.erode(mask, np.ones((3, 3), np.uint8)) > 0].all()


def test_only_markers_that_are_here_can_be_covered() -> None:
    (shot,) = shots([[MarkerCovered(marker_id=17)]])
    with pytest.raises(RequestRefused, match="marker_id = 17: here are 0, 1, 2, 3") as refusal:
        clean_camera().take(shot)
    assert refusal.value.cause == "refused.unknown_marker"


def test_the_plant_knows_how_its_camera_moves() -> None:
    plant = Plant(plant_config(), seed=1)
    driver = Driver(plant)
    driver.run(0.5, (0.3, 0.3, -0.2, 0.2, 0.2, 0.4))
    now, motion = plant.truth(), plant.motion()
    assert np.linalg.norm(motion.rates[0, :3]) > 0.05
    before = (now.X_WC, now.X_WM)
    plant.advance(2_000_000)
    after = plant.truth()
    reached = motion.at(CameraView(*before), 2e-3)
    for X, Y in zip(reached[:2], (after.X_WC, after.X_WM), strict=True):
        np.testing.assert_allclose(X, Y, atol=2e-5)  # what it accelerates in 2 ms
    assert np.abs(after.X_WC - before[0]).max() > 1e-4
