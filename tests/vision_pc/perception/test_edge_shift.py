"""Edges that a camera's response curve shows on their black side: found by a marker's cells, and put back."""

import cv2
import numpy as np

from tests.vision_pc.perception.test_markers import object_markers, tool_marker
from tests.vision_pc.rendering import Marker, draw_marker, exact_corners, facing, render
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics, look, marker_edges
from vision_pc.core.perception.marker_edges import cells_of, edge_shift
from vision_pc.core.types import CameraCalibration, Image, StereoPair

DICTIONARY = "DICT_5X5_1000"


def as_seen(image: Image, gamma: float, blur_px: float) -> Image:
    """A picture of light as a camera with that blur and response shows it."""
    light = (
        cv2.GaussianBlur(image.astype(np.float32), (0, 0), blur_px) if blur_px else image.astype(np.float32)
    )
    return np.asarray(np.rint(255.0 * (light / 255.0) ** gamma), dtype=np.uint8)


def inward_px(picture: Image, camera: CameraCalibration, marker: Marker, finds: bool) -> float:
    """How far inside (mean, px, across an edge) the corners are found."""
    corners = exact_corners(camera.left, marker)
    rays = marker_edges.refine(picture, corners, lambda px: intrinsics.normalised(camera.left, px))
    seen = intrinsics.distorted(camera.left, rays)
    if finds:
        shift = edge_shift(picture, seen, cells_of(DICTIONARY, marker.marker_id))
        rays = marker_edges.refine(picture, seen, lambda px: intrinsics.normalised(camera.left, px), shift)
        seen = intrinsics.distorted(camera.left, rays)
    away = corners - corners.mean(axis=0)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    return float(((corners - seen) * away).sum(axis=1).mean()) / np.sqrt(2.0)


def test_a_camera_that_goes_with_the_light_moves_nothing(
    camera: CameraCalibration, generator: np.random.Generator
) -> None:
    marker = Marker(2, 0.12, facing(0.1, 0.05, 1.0, (10, -15, 5)))
    picture = np.full((720, 1280), 118.0, np.float32)
    draw_marker(picture, camera.left, marker)
    image = np.clip(np.rint(picture + generator.normal(0.0, 2.0, picture.shape)), 0, 255).astype(np.uint8)
    assert abs(inward_px(image, camera, marker, finds=True)) < 0.015


def test_small_hidden_and_blank_markers_tell_nothing(camera: CameraCalibration) -> None:
    cells = cells_of(DICTIONARY, 2)
    far = Marker(2, 0.12, facing(0.1, 0.05, 3.0))
    picture = np.full((720, 1280), 118.0, np.float32)
    draw_marker(picture, camera.left, far)
    assert edge_shift(picture.astype(np.uint8), exact_corners(camera.left, far), cells) is None
    near = exact_corners(camera.left, Marker(2, 0.12, facing(0.1, 0.05, 1.0)))
    assert edge_shift(np.full((720, 1280), 118, np.uint8), near, cells) is None
    noise = np.random.default_rng(1).integers(0, 256, (720, 1280)).astype(np.uint8)
    assert edge_shift(noise, near, cells) is None
    assert edge_shift(noise, near - near.min(axis=0) - 50.0, cells) is None
    assert edge_shift(noise, np.full((4, 2), np.nan), cells) is None


def test_distances_by_a_camera_with_a_gamma_are_right(
    camera: CameraCalibration, config: VisionConfig, generator: np.random.Generator
) -> None:
    """Eyes that know no offset: what is wrong of a marker's size goes against the disparity."""
    X_CM, X_CO = facing(0.1, 0.0, 0.4, (5, 10, 0)), facing(-0.3, 0.1, 1.3, (10, -10, 5))
    light = render(camera, (tool_marker(X_CM), *object_markers(X_CO)), generator, noise=0.0)
    pair = StereoPair(*(as_seen(image, 0.5, 0.85) for image in (light.left, light.right)), 0, 0)
    off = {}
    for finds in (False, True):
        settings = config.markers.model_copy(update={"finds_edge_shift": finds, "offset_std_px": 3.5})
        seen = look.observe(pair, camera, settings)
        off[finds] = float(np.abs(se3.local(X_CO, seen.X_CO)[:3]).max())
    assert off[False] > 5e-3
    assert off[True] < 1.5e-3
