"""Markers that are no one's, hidden, in the shade, of the wrong size or doubtful: refused, or read."""

import cv2
import numpy as np
import pytest

from tests.vision_pc.perception.test_markers import object_markers, observed, tool_marker
from tests.vision_pc.rendering import Marker, exact_corners, facing, render
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception import look
from vision_pc.core.types import CameraCalibration, StereoPair


def test_unknown_repeated_and_foreign_markers_are_refused(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator
) -> None:
    scene = (
        Marker(17, 0.12, facing(-0.6, 0.0, 1.2)),
        Marker(1, 0.12, facing(-0.2, 0.0, 1.2)),
        Marker(1, 0.12, facing(0.2, 0.0, 1.2)),
        Marker(0, 0.10, facing(0.6, 0.0, 1.2), dictionary=cv2.aruco.DICT_4X4_1000),
    )
    seen = observed(camera, config.markers, scene, generator)
    assert seen.X_CM is None
    assert seen.X_CO is None
    assert seen.markers == ()
    assert seen.rejected == {"unknown_id": 1, "repeated_id": 1}
    assert (seen.missing_tool, seen.missing_object) == ("not_seen", "seen_twice")


def in_shade(pair: StereoPair, columns: list[float], left: float) -> StereoPair:
    """``pair`` in a shade that leaves ``left`` of the light beyond a column of each eye's picture."""
    pictures = []
    for image, column in zip((pair.left, pair.right), columns, strict=True):
        beyond = np.clip((np.arange(image.shape[1]) - column) / 20.0 + 0.5, 0.0, 1.0)  # penumbra 20 px wide
        pictures.append(np.rint(image * (1.0 - (1.0 - left) * beyond)).astype(np.uint8))
    return pair._replace(left=pictures[0], right=pictures[1])


@pytest.mark.parametrize("left", [0.6, 0.4, 0.25])
def test_a_marker_half_in_the_shade_is_read(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator, left: float
) -> None:
    """Its white in the shade is nearer to black than to white in the light."""
    tool, X_CO = tool_marker(facing(0.1, 0.0, 0.5, (10, 15, 0))), facing(-0.4, 0.0, 1.0)
    pair = render(camera, (tool, *object_markers(X_CO)), generator)
    middles = [float(exact_corners(eye, tool)[:, 0].mean()) for eye in (camera.left, camera.right)]
    seen = look.observe(in_shade(pair, middles, left), camera, config.markers)
    assert np.abs(se3.local(tool.X_CA, seen.X_CM)[:3]).max() < 1e-3
    assert len(seen.markers) == 4
    assert all(marker.corners_right is not None for marker in seen.markers)
    assert seen.rejected == {}


def test_a_repeated_marker_is_no_better_where_shade_hides_one(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator
) -> None:
    """The one in the light is read at once, its twin only in the logarithm."""
    light, dark = (Marker(0, 0.10, facing(x, 0.0, 0.6)) for x in (-0.15, 0.15))
    pair = render(camera, (light, dark), generator)
    middles = [float(exact_corners(eye, dark)[:, 0].mean()) for eye in (camera.left, camera.right)]
    seen = look.observe(in_shade(pair, middles, 0.25), camera, config.markers)
    assert seen.X_CM is None
    assert seen.rejected == {"repeated_id": 1}


def test_stranger_among_the_objects_markers_is_left_out(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator
) -> None:
    X_CO = facing(-0.2, 0.0, 1.0, (5, 5, 0))
    moved = Marker(3, 0.12, X_CO @ se3.transform(np.eye(3), (0.05, 0.23, 0.0)), rim=0.17)
    seen = observed(camera, config.markers, (*object_markers(X_CO, (1, 2)), moved), generator)
    assert np.abs(se3.local(X_CO, seen.X_CO)[:3]).max() < 1e-3
    assert seen.rejected == {"residual": 1}


def test_marker_half_hidden_in_the_right_eye_is_measured_by_the_left(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator
) -> None:
    X_CO = facing(0.0, 0.0, 1.0, (5, 5, 0))
    pair = render(camera, object_markers(X_CO), generator)
    hidden = pair.right.copy()
    corners = exact_corners(camera.right, object_markers(X_CO)[1])
    x0, y0 = corners.min(axis=0).astype(int)
    hidden[y0 - 30 : y0 + 100, x0 + 25 :] = 60
    seen = look.observe(pair._replace(right=hidden), camera, config.markers)
    assert {m.marker_id: m.corners_right is not None for m in seen.markers} == {1: True, 2: False, 3: True}
    assert np.abs(se3.local(X_CO, seen.X_CO)[:3]).max() < 1e-3


def test_doubtful_pose_is_refused_alone_and_decided_by_the_frame_before(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator
) -> None:
    """One eye, far away, little tilt, and corners believed to be coarse: both planar poses explain what is
    seen.
    """
    coarse = config.markers.model_copy(update={"corner_std_px": 0.5, "residual_limit_px": 2.0})
    X_CM = facing(0.0, 0.0, 2.5, (8, 0, 0))
    pair = render(camera, (tool_marker(X_CM),), generator)
    pair = pair._replace(right=np.full_like(pair.right, 118))
    alone = look.observe(pair, camera, coarse)
    assert alone.X_CM is None
    assert alone.rejected == {"ambiguous": 1}
    for truth in (X_CM, facing(0.0, 0.0, 2.5, (-8, 0, 0))):
        before = alone._replace(X_CM=truth, frame_id=-1)
        decided = look.observe(pair, camera, coarse, before)
        assert np.degrees(se3.angle_between(decided.X_CM[:3, :3], truth[:3, :3])) < 4.0
