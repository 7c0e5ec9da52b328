"""What is wrong with a real camera's geometry: two lenses, drift, shutter, stamps, hung and bent plates.

Each is checked against an answer that does not come from the code that makes the effect, and in the picture.
"""

from typing import Any

import cv2
import numpy as np
import pytest

from foundation.configuration import load
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.exposures import CameraMotion, Capture, Drift, Exposures, Shot
from plant_emulator.core.camera.stereo_camera import LEFT, RIGHT, StereoCamera
from plant_emulator.core.mechanics.geometry import rotation_from_vector
from protocol.errors import ConfigurationError
from testbed.lockstep.true_view import TrueView
from tests.plant_emulator.camera.camera_world import (
    CLEAN,
    Matrix,
    camera,
    clean_camera,
    even_plate,
    scene_config,
    start_view,
    wall_view,
)
from tests.plant_emulator.camera.corner_oracle import project_corners, refined_corners
from tests.support.paths import CONFIGS

DIFFERENT = {"fx_px": 0.26, "fy_px": -0.2, "k1": 0.0015, "k2": -0.0004, "p1": -0.0002, "p2": 0.0002}
AS_MEANT = {"misplaced_m": [0.0, 0.0, 0.0], "misplaced_deg": [0.0, 0.0, 0.0]}
FOUND_PX = 0.03  # how well the oracle finds a corner in a picture without noise


def with_camera(**keys: Any) -> StereoCamera:
    """The clean camera with more keys."""
    return camera(CLEAN | {"camera": CLEAN["camera"] | keys})


def found_in(picture: np.ndarray, wanted: Matrix) -> Matrix:
    """A marker's corners (4, 2) as the oracle finds them near ``wanted``."""
    corners = refined_corners(picture, wanted, 4, 6.0)
    assert corners is not None
    return corners


def taken(eyes: StereoCamera, capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    """The pair of a capture."""
    return eyes.take(Shot(capture.frame_id, capture.capture_ns, capture, None, (), True))


def test_two_lenses_leave_the_disparity_residual_that_opencv_computes() -> None:
    alike, different = clean_camera(), with_camera(lens_difference=DIFFERENT)
    view = start_view(alike.scene)
    rays = np.array([[x, y, 1.0] for x in (-0.9, 0.0, 0.8) for y in (-0.5, 0.1, 0.5)])
    points = 1.3 * rays @ view.X_WC[:3, :3].T + view.X_WC[:3, 3]
    residual = [eyes.project(view.X_WC, points) for eyes in (alike, different)]
    lens, rect = alike.config.lens, alike.config.rectification
    in_right = 1.3 * rays - [alike.config.baseline_m, 0.0, 0.0]
    turn = rotation_from_vector(-np.radians(rect.right_eye_rotation_deg))
    K = np.array(
        [
            [lens.fx_px + 0.26, 0.0, lens.cx_px - rect.disparity_px],
            [0.0, lens.fy_px - 0.2, lens.cy_px + rect.vertical_px],
            [0.0, 0.0, 1.0],
        ]
    )
    k = np.array([lens.k1 + 0.0015, lens.k2 - 0.0004, lens.p1 - 0.0002, lens.p2 + 0.0002, lens.k3])
    expected, _ = cv2.projectPoints(in_right @ turn.T, np.zeros((3, 1)), np.zeros((3, 1)), K, k)
    np.testing.assert_allclose(residual[1][RIGHT], expected[:, 0], atol=1e-9)
    np.testing.assert_array_equal(residual[1][LEFT], residual[0][LEFT])
    assert np.abs(residual[1][RIGHT] - residual[0][RIGHT]).max() > 0.5


def test_drift_begins_at_zero_and_spreads_as_a_first_order_walk() -> None:
    config = scene_config({"camera": {"drift": {"disparity_px": 0.2, "vertical_px": 0.1}}}).camera.drift
    at_s = (600.0, 6000.0)
    walks = []
    for seed in range(400):
        drift = Drift(config, seed)
        assert drift.at(5_000_000_000) == (0.0, 0.0)
        walks.append([drift.at(5_000_000_000 + round(1e9 * t)) for t in at_s])
    spread = np.std(walks, axis=0)
    settled = np.sqrt(1.0 - np.exp(-2.0))
    np.testing.assert_allclose(spread[0], [0.2 * settled, 0.1 * settled], rtol=0.12)
    np.testing.assert_allclose(spread[1], [0.2, 0.1], rtol=0.12)
    assert abs(np.corrcoef(np.array(walks)[:, 1].T)[0, 1]) < 0.15


def test_drift_is_the_same_whenever_it_is_asked_for() -> None:
    config = scene_config({"camera": {"drift": {"disparity_px": 0.2}}}).camera.drift
    often, once = Drift(config, 3), Drift(config, 3)
    once.at(0)
    for second in range(900):
        last = often.at(second * 1_000_000_000)
    assert last == once.at(899_000_000_000)
    assert often.at(450_000_000_000) == once.at(450_000_000_000)
    steps = np.diff([often.at(second * 1_000_000_000)[0] for second in range(900)])
    assert 0.0 < np.abs(steps).max() < 0.02  # it wanders and does not jump


def test_a_drifted_right_eye_shows_so_much_more_disparity_and_rows() -> None:
    eyes, view = clean_camera(), wall_view(clean_camera().scene, 1.0)
    capture = Capture(1, 0, view, drift_px=(0.8, -0.4))
    middle = np.array([[0.0, 0.0, 1.0]]) + eyes.eyes[RIGHT].true.X_CE[:3, 3]
    point = middle @ view.X_WC[:3, :3].T + view.X_WC[:3, 3]
    true = eyes.eyes[RIGHT].true
    moved = true.project(view.X_WC, point, capture.drift_px) - true.project(view.X_WC, point)
    np.testing.assert_allclose(moved, [[-0.8, -0.4]], atol=1e-3)
    still = taken(eyes, Capture(1, 0, view))
    drifted = taken(eyes, capture)
    assert np.array_equal(still[LEFT], drifted[LEFT])
    expected = TrueView(eyes.config, eyes.scene).markers(capture)[3].right
    assert expected is not None
    assert np.abs(found_in(drifted[RIGHT], expected) - expected).max() < FOUND_PX
    assert np.abs(found_in(still[RIGHT], expected) - expected).max() > 0.5


@pytest.mark.parametrize(("mode_hz", "readout_ms"), [(60, 11.3), (30, 18.4), (15, 36.9)])
def test_a_moving_edge_leans_by_speed_times_line_time(mode_hz: int, readout_ms: float) -> None:
    """The published times of the 720 rows; the skew of a straight edge is their share between two rows."""
    plate = even_plate((0.0, 0.0), (0.4, 4.0), 220.0)
    dark = CLEAN["wall"] | {"contrast_grey": 0.0, "mean_grey": 60.0}
    pinhole = dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
    shutter = {"kind": "rolling", "mode_hz": mode_hz}
    keys = CLEAN["camera"] | {"lens": pinhole, "shutter": shutter}
    eyes = camera(CLEAN | {"passers": [plate], "wall": dark, "camera": keys})
    view = wall_view(eyes.scene, 1.0)
    speed = 0.7
    along = -eyes.scene.mounts.X_WO[:3, 0] * speed  # the camera goes left
    motion = CameraMotion(np.array([[*along, 0.0, 0.0, 0.0], [0.0] * 6]))
    picture = eyes.render_eye(LEFT, view, 1, motion).astype(float)
    edges = [float((picture[row, :700] - 60.0).sum() / 160.0) for row in (100, 620)]
    skew = 520 / 720 * readout_ms / 1e3 * speed * eyes.config.lens.fx_px
    assert edges[0] - edges[1] == pytest.approx(skew, rel=0.01)


def test_rendered_and_projected_rolling_shutter_agree() -> None:
    eyes = with_camera(shutter={"kind": "rolling", "mode_hz": 15})
    view = start_view(eyes.scene)
    rates = np.array([[0.05, 0.3, -0.1, 0.02, 0.04, 0.03], [0.05, 0.25, -0.1, 0.0, 0.0, 0.1]])
    capture = Capture(1, 0, view, CameraMotion(rates))
    pair = taken(eyes, capture)
    true_view = TrueView(eyes.config, eyes.scene)
    moving, still = true_view.markers(capture), true_view.markers(Capture(1, 0, view))
    skew = 0.0
    for marker, seen in moving.items():
        for eye, expected in enumerate(seen):
            if expected is not None:
                assert np.abs(found_in(pair[eye], expected) - expected).max() < FOUND_PX, marker
                unmoved = still[marker][eye]
                skew = max(skew, 0.0 if unmoved is None else float(np.abs(expected - unmoved).max()))
    assert skew > 0.5


def test_stamps_are_late_by_the_delay_and_spread_by_the_jitter() -> None:
    config = scene_config({"camera": {"stamps": {"delay_ms": 20.0, "jitter_ms": 4.0}}}).camera
    exposures, view = Exposures(config, 5), start_view(clean_camera().scene)
    shots = [exposures.shot(Capture(n, n * 100_000_000, view), []) for n in range(1, 2001)]
    error_ms = np.array([1e-6 * (shot.capture_ns - shot.shown.capture_ns) for shot in shots])
    assert error_ms.mean() == pytest.approx(20.0, abs=0.3)
    assert error_ms.std() == pytest.approx(4.0, rel=0.06)
    assert np.abs(error_ms - 20.0).max() <= 12.0 + 1e-6
    assert (np.diff([shot.capture_ns for shot in shots]) > 0).all()
    again = Exposures(config, 5).shot(Capture(7, 700_000_000, view), [])
    assert again.capture_ns == shots[6].capture_ns
    early = scene_config({"camera": {"stamps": {"delay_ms": -150.0}}}).camera
    assert Exposures(early, 5).shot(Capture(1, 100_000_000, view), []).capture_ns == 0


def test_a_misplaced_marker_is_seen_where_it_hangs() -> None:
    markers = scene_config().model_dump()["object_of_interest"]["markers"]
    changed = dict(markers[0]) | {"misplaced_m": [0.001, -0.0008, 0.0005], "misplaced_deg": [0.0, 0.0, 1.0]}
    eyes = camera(CLEAN | {"object_of_interest": {"markers": [changed, *markers[1:]]}})
    _, hung = eyes.scene.marker_corners()[markers[0]["marker_id"]]
    straight = camera(CLEAN | {"object_of_interest": {"markers": [markers[0] | AS_MEANT, *markers[1:]]}})
    _, meant = straight.scene.marker_corners()[markers[0]["marker_id"]]
    np.testing.assert_allclose(hung.mean(axis=0) - meant.mean(axis=0), [0.001, -0.0008, 0.0005], atol=1e-12)
    side = hung[1] - hung[0]
    assert np.degrees(np.arctan2(side[1], side[0])) == pytest.approx(1.0)
    view = start_view(eyes.scene)
    expected = project_corners(eyes, *view)[markers[0]["marker_id"]][LEFT]
    assert np.abs(found_in(eyes.render_eye(LEFT, view, 1), expected) - expected).max() < FOUND_PX


@pytest.mark.parametrize("direction_deg", [0.0, 90.0, 45.0])
def test_a_bent_plates_corners_stand_off_its_middle(direction_deg: float) -> None:
    marker = scene_config().model_dump()["object_of_interest"]["markers"][0]
    bend = AS_MEANT | {"bend_m": 0.004, "bend_direction_deg": direction_deg, "print_scale_error": 0.0}
    eyes = camera(CLEAN | {"object_of_interest": {"markers": [marker | bend]}})
    _, corners = eyes.scene.marker_corners()[marker["marker_id"]]
    # a corner is half the side away along the bend, or at 45 degrees half the diagonal or nothing
    rise = [0.004] * 4 if direction_deg != 45.0 else [0.0, 0.008, 0.0, 0.008]
    np.testing.assert_allclose(corners[:, 2], rise, atol=1e-12)
    oblique = wall_view(eyes.scene, 0.7, (0.0, 25.0, 0.0))
    expected = project_corners(eyes, *oblique)[marker["marker_id"]][LEFT]
    flat_O = (corners * [1, 1, 0]) @ eyes.scene.mounts.X_WO[:3, :3].T + eyes.scene.mounts.X_WO[:3, 3]
    flat, _ = eyes.project(oblique.X_WC, flat_O)
    picture = eyes.render_eye(LEFT, oblique, 1)
    columns, rows = np.rint(expected.mean(axis=0)).astype(int)
    assert picture[rows - 60 : rows + 60, columns - 60 : columns + 60].std() > 40.0  # it is there at all
    # the oracle fits straight lines, but the rims across the bend are curves
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
    near = [corner.astype(np.float32).reshape(1, 1, 2) for corner in expected]
    found = np.array([cv2.cornerSubPix(picture, at, (4, 4), (-1, -1), stop)[0, 0] for at in near])
    at_flat = np.abs(flat - expected).max(axis=1)
    assert at_flat.max() > 1.0
    assert np.abs(found - expected).max() < 0.45  # cornerSubPix is biased inward by a quarter of a pixel


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"stamps": {"jitter_ms": 20.0}}, "stamps.jitter_ms 20"),
        ({"rate_hz": 60.0, "shutter": {"kind": "rolling", "mode_hz": 15}}, "longer than a frame"),
        ({"shutter": {"mode_hz": 20}}, "mode_hz"),
        ({"lens": {"k1": -0.06}, "lens_difference": {"k1": -0.06}}, "lens [+] lens_difference: k1"),
        ({"lens_difference": {"cx_px": 51.0}}, "less than or equal to 50"),
        ({"drift": {"disparity_px": -0.1}}, "greater than or equal to 0"),
    ],
)
def test_what_no_camera_can_be_is_refused(keys: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        load(SceneConfig, CONFIGS / "scene.yaml", {"camera": keys})
