"""Markers fitted with all of their cells: exact corners, honest σ, numbers that OpenCV does not read."""

from typing import NamedTuple

import cv2
import numpy as np
import pytest

from tests.vision_pc.rendering import Marker, draw_marker, exact_corners, facing, finish
from vision_pc.core import se3
from vision_pc.core.perception.marker_template import fit
from vision_pc.core.perception.picture_markers import search
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraModel, Image

FAMILY = "DICT_APRILTAG_36h11"
BOOK = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def cells_of(number: int) -> Array:
    return (BOOK.generateImageMarker(number, 8) > 0).astype(np.float64)


class MarkerAspect(NamedTuple):
    """How markers are seen: side in px as if from the front, angle off the normal, σ of blur and noise."""

    side_px: float = 40.0
    angle_deg: float = 20.0
    blur_px: float = 0.7
    noise_grey: float = 2.0


class TagPicture(NamedTuple):
    """A picture, and the true corners (4, 2) px of its markers by number, in ArUco's order."""

    image: Image
    corners: dict[int, Array]


def picture_of(aspect: MarkerAspect) -> TagPicture:
    """18 markers in 6 × 3 tiles of a 720p picture; each is looked at along the line to its middle."""
    rng, corners = np.random.default_rng(11), {}
    picture = np.full((720, 1280), 110.0)
    for k, number in enumerate(rng.permutation(587)[:18].tolist()):
        K = np.array([[530.0, 0.0, 213.3 * (k % 6 + 0.5)], [0.0, 530.0, 240.0 * (k // 6 + 0.5)], [0, 0, 1]])
        K[:2, 2] += rng.uniform(-20.0, 20.0, 2)
        eye = CameraModel(K, np.zeros(5), np.eye(4))
        axis, turn = rng.uniform(0.0, 360.0, 2)
        tilt = aspect.angle_deg * np.array([np.cos(np.radians(axis)), np.sin(np.radians(axis)), 0.0])
        X = facing(0.0, 0.0, 530.0 / aspect.side_px, tuple(tilt))
        X = X @ se3.transform(se3.exp_so3([0.0, 0.0, np.radians(turn)]), np.zeros(3))
        marker = Marker(number, 1.0, X, 0.125, cv2.aruco.DICT_APRILTAG_36h11)
        draw_marker(picture, eye, marker)
        corners[number] = exact_corners(eye, marker)
    return TagPicture(finish(picture, rng, aspect.noise_grey, aspect.blur_px), corners)


def fitted(picture: TagPicture) -> tuple[Array, Array]:
    """Of every marker, begun 0.5 px (σ) from its corners: their errors (n, 4, 2), and σ (n, 1, 1), px."""
    rng = np.random.default_rng(3)
    found = [
        (corners, fit(picture.image, corners + rng.normal(0.0, 0.5, (4, 2)), cells_of(number)))
        for number, corners in picture.corners.items()
    ]
    errors = np.array([one.corners - corners for corners, one in found])
    return errors, np.array([one.std_px for _, one in found])[:, None, None]


@pytest.mark.parametrize(
    ("aspect", "limit_px"),
    [
        (MarkerAspect(60.0), 0.02),
        (MarkerAspect(20.0), 0.06),
        (MarkerAspect(14.0), 0.1),
        (MarkerAspect(40.0, angle_deg=70.0), 0.06),
        (MarkerAspect(40.0, blur_px=2.0), 0.06),
        (MarkerAspect(40.0, noise_grey=20.0), 0.1),
    ],
    ids=["60 px", "20 px", "14 px", "70 deg", "blur", "noise"],
)
def test_corners_are_exact_and_as_sure_as_told(aspect: MarkerAspect, limit_px: float) -> None:
    errors, told = fitted(picture_of(aspect))
    assert np.sqrt(np.mean(errors**2)) < limit_px
    assert 0.3 < np.mean((errors / told) ** 2) < 3.0


def test_white_that_is_cut_off_leaves_corners_as_sure_as_told() -> None:
    picture = picture_of(MarkerAspect(40.0, blur_px=0.8))
    light = np.clip(2.5 * picture.image.astype(np.float64), 0.0, 255.0).astype(np.uint8)
    assert (light == 255).mean() > 0.4
    errors, told = fitted(TagPicture(light, picture.corners))
    assert np.mean((errors / told) ** 2) < 3.0


def test_another_number_is_not_what_is_seen() -> None:
    picture = picture_of(MarkerAspect(40.0))
    for number, corners in picture.corners.items():
        assert fit(picture.image, corners, cells_of((number + 100) % 587)) is None


@pytest.mark.parametrize(
    "corners",
    [
        np.full((4, 2), np.nan),
        np.zeros((4, 2)),
        np.array([[10.0, 10.0], [50.0, 10.0], [10.0, 50.0], [50.0, 50.0]]),  # a bow tie
        np.array([[10.0, 10.0], [30.0, 10.0], [50.0, 10.0], [70.0, 10.0]]),  # on a line
        np.array([[-90.0, -90.0], [-50.0, -90.0], [-50.0, -50.0], [-90.0, -50.0]]),
        np.array([[700.0, 700.0], [740.0, 700.0], [740.0, 740.0], [700.0, 740.0]]),
        np.array([[10.0, 10.0], [10.0, 50.0], [50.0, 50.0], [50.0, 10.0]]),  # seen from behind
    ],
    ids=["nan", "point", "bow tie", "line", "outside", "partly outside", "from behind"],
)
def test_what_is_no_square_in_the_picture_is_no_marker(corners: Array) -> None:
    image = np.random.default_rng(1).integers(0, 255, (720, 1280)).astype(np.uint8)
    assert fit(image, corners, cells_of(5)) is None


def test_markers_that_opencv_sees_and_cannot_read_are_read() -> None:
    picture = picture_of(MarkerAspect(14.0))
    _, ids, _ = cv2.aruco.ArucoDetector(BOOK).detectMarkers(picture.image)
    found = search(picture.image, FAMILY).markers
    assert {marker.number for marker in found} <= picture.corners.keys()
    assert len(ids) + 3 < len(found)
    for marker in found:
        assert marker.method == "cells"
        assert np.abs(marker.corners - picture.corners[marker.number]).max() < 0.4
