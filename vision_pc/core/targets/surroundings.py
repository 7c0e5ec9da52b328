"""What lies around a place that looks like others: which of them it speaks for.

A click in the other eye chooses among places that look alike. A black square of a board, taken for another
one, may be a hole of the width that is drilled. Nothing of the place itself contradicts that.
What is around can: on the plane of the right one both eyes see the same there too, such as the board's rim
and the wall beside it.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vision_pc.core.odometry.moving_regions import static_pixels
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.targets.place_on_plane import plane_at
from vision_pc.core.targets.row_matching import DEPTHS_M, places_alike, right_pixels
from vision_pc.core.targets.sighting import Sighted, region
from vision_pc.core.targets.target import TargetObservation, TargetRefused
from vision_pc.core.types import CameraCalibration, Image

_REACH_PX = 480  # about the click
_EVERY_PX = 2  # so many pixels one is looked at, in smoothed pictures
_BLOCK = 12  # of these to a side of a block
_SHOWS = 4.0  # grey: standard deviation of a block that shows something
_SAME, _OTHER = 0.8, 0.5  # correlation of a block that both eyes see on a plane, and that they do not
_LEAST = 4  # blocks that must speak for another place
_TIMES = 3  # so many times what speaks for the chosen one
_SAME_PLACE_PX = 4.0


class _Around(NamedTuple):
    """The left eye about a click: greys, rays (n, m, 3), what of it stands still; and the right eye."""

    grey: Array
    rays: Array
    still: NDArray[np.bool_]
    other: Array


def refuse_contradicted(
    sighted: Sighted, camera: CameraCalibration, pixel: Array, chosen: TargetObservation
) -> TargetObservation:
    """``chosen``, which was measured about ``pixel`` (2,) of the left eye.

    Raises TargetRefused (``target.contradicted``, with candidates) where others outdo it in their looks, or
    where what lies around speaks for another of those that look alike.
    """
    alike = places_alike(sighted.pair, camera, pixel, DEPTHS_M)
    ray, n = np.append(intrinsics.normalised(camera.left, pixel[None])[0], 1.0), _plane_of(chosen)
    at = right_pixels(camera.right, ray[None], np.array([n @ ray]))[0]
    others = [other for other in alike if np.abs(other.right_px - at).max() > _SAME_PLACE_PX]
    if alike and len(others) == len(alike) and chosen.kind == "plane":
        why = "target: other places look more like it than the one that was clicked in the other eye"
        raise TargetRefused("target.contradicted", why, alike)
    if not others:
        return chosen
    around = _around(sighted, camera, pixel)
    own = _correlations(camera, around, n)
    for other in others:
        try:
            plane = plane_at(sighted.pair, camera, pixel, 1.0 / float(other.p_C[2]))
        except TargetRefused:
            continue
        its = _correlations(camera, around, plane.n)
        for_it = int(((its > _SAME) & (own < _OTHER)).sum())
        against = int(((own > _SAME) & (its < _OTHER)).sum())
        if for_it >= _LEAST and for_it > _TIMES * against:
            far, near = (1e3 * float(np.linalg.norm(ray / (each @ ray))) for each in (n, plane.n))
            raise TargetRefused(
                "target.contradicted",
                f"target: at {far:.0f} mm from the camera {for_it} places around it do not fit; they fit at "
                f"{near:.0f} mm",
                alike,
            )
    return chosen


def _plane_of(seen: TargetObservation) -> Array:
    """n (3,) 1/m with n·P = 1 of the surface of a target."""
    normal = seen.X_CO[:3, 2]
    return np.asarray(normal / (normal @ seen.X_CO[:3, 3]))


def _around(sighted: Sighted, camera: CameraCalibration, pixel: Array) -> _Around:
    left, top, right, bottom = region(pixel[0], pixel[1], _REACH_PX, camera)
    columns, rows = np.meshgrid(np.arange(left, right, _EVERY_PX), np.arange(top, bottom, _EVERY_PX))
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    xy = intrinsics.normalised(camera.left, pixels).reshape(*columns.shape, 2)
    X_CM, still = sighted.observation.X_CM, np.ones(columns.shape, dtype=bool)
    if X_CM is not None:
        still = static_pixels(X_CM, sighted.markers.tool, camera)[0][rows, columns] > 0
    rays = np.concatenate([xy, np.ones((*columns.shape, 1))], axis=2)
    left_eye, other = (_smooth(picture) for picture in (sighted.pair.left, sighted.pair.right))
    return _Around(left_eye[rows, columns], rays, still, other)


def _smooth(image: Image) -> Array:
    return np.asarray(cv2.GaussianBlur(image, (5, 5), 0.5 * _EVERY_PX).astype(np.float32))


def _correlations(camera: CameraCalibration, around: _Around, n: Array) -> Array:
    """Correlations of both eyes, block by block, on the plane n·P = 1; NaN where nothing can be said."""
    inverse = around.rays @ n
    at = right_pixels(camera.right, around.rays.reshape(-1, 3), inverse.ravel()).astype(np.float32)
    at = at.reshape(*inverse.shape, 2)
    seen = cv2.remap(around.other, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0)
    size = np.array([camera.width, camera.height]) - 1
    valid = around.still & (inverse > 0.0) & np.all((at >= 0.0) & (at <= size), axis=2)
    blocks = [_blocks(values) for values in (around.grey, seen)]
    first, second = (each - each.mean(axis=2, keepdims=True) for each in blocks)
    spread = np.sqrt((first**2).mean(axis=2) * (second**2).mean(axis=2))
    shows = (first.std(axis=2) > _SHOWS) & _blocks(valid).all(axis=2)
    return np.where(shows, (first * second).mean(axis=2) / np.maximum(spread, 1e-9), np.nan)


def _blocks(values: NDArray[Any]) -> NDArray[Any]:
    """(n, m, pixels of a block)"""
    rows, columns = (length // _BLOCK for length in values.shape)
    whole = values[: rows * _BLOCK, : columns * _BLOCK]
    cut = whole.reshape(rows, _BLOCK, columns, _BLOCK).swapaxes(1, 2)
    return np.asarray(cut.reshape(rows, columns, _BLOCK**2))
