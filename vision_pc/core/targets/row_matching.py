"""Where the right eye sees what the left one sees at a pixel, or why that cannot be told.

A pattern that repeats along the row has no unique match: whoever takes the best peak there answers a wrong
place with confidence. The second peak, and the way back from the right eye to the left, tell.
"""

import cv2
import numpy as np

from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.targets.target import Candidate, TargetRefused
from vision_pc.core.types import CameraCalibration, CameraModel, Image, StereoPair

DEPTHS_M = (0.3, 4.0)  # [D] of the search along the row; a pixel of disparity is 0.25 m at the farther
HALF = 15  # px of the template on either side
_BLURRED = 2  # px beyond it, for the smoothing
_ROWS = 3  # px that the right eye may be off its row
_LEAST = 0.60  # correlation below which nothing was found
_APART = 4  # px between peaks that are different places
_MARGIN = 0.10  # by how much the best peak must beat every other
_BACK = 1.5  # px by which the way back may miss
_RIM = 40  # px at the picture's rim in which nothing is measured
_MOST_NAMED = 24  # places that look alike
_TEXTURE = 1.6  # grey: standard deviation of a smoothed template below which it shows noise alone


def match(
    pair: StereoPair,
    camera: CameraCalibration,
    pixel: Array,
    depths_m: tuple[float, float],
    half: int = HALF,
) -> float:
    """The inverse depth (1/m) of what the left eye sees at ``pixel`` (2,) px, by the one place in the right
    picture that looks like it.

    ``depths_m``: nearest and farthest. ``half``: px about it that are compared, fewer at the picture's rim.
    Raises TargetRefused: ``target.outside_picture``, ``target.low_texture``, ``target.ambiguous`` with
    candidates, ``target.no_match``.
    """
    refuse_outside(pixel, camera)
    to_rim = np.minimum(pixel, np.array([camera.width, camera.height]) - 1 - pixel).min()
    half = min(half, int(to_rim) - _BLURRED)
    template = _template(pair.left, pixel, half)
    contrast = float(template.std())
    if contrast < _TEXTURE:
        raise TargetRefused(
            "target.low_texture",
            f"target: contrast {contrast:.1f} grey levels, at least {_TEXTURE:g} are wanted: bare surface",
        )
    ray = np.append(intrinsics.normalised(camera.left, pixel[None])[0], 1.0)
    ends = np.array([_seen_right(camera, ray, 1.0 / depth) for depth in depths_m])
    places, scores = _peaks(pair.right, template, ends)
    if not len(scores) or scores[0] < _LEAST:
        best = scores[0] if len(scores) else 0.0
        bare = contrast < 3.0 * _TEXTURE
        cause, why = ("low_texture", ", and little to see") if bare else ("no_match", "")
        words = f"target: nothing looks like it in the other eye{why}: correlation {best:.2f}"
        raise TargetRefused(f"target.{cause}", f"{words}, at least {_LEAST} is wanted")
    alike = scores > scores[0] - _MARGIN
    if alike.sum() > 1:
        raise _ambiguous(camera, ray, places[alike], f"{alike.sum()} places look alike in the other eye")
    back, scores = _peaks(pair.left, _template(pair.right, places[0], half), _way_back(pixel, ends))
    alike = scores > scores[0] - _MARGIN if len(scores) else np.zeros(0, dtype=bool)
    if alike.sum() != 1 or np.abs(back[0] - pixel).max() > _BACK:
        raise _ambiguous(camera, ray, places[:1], "the other eye's place for it lies elsewhere in this one")
    return _inverse_depth(camera, ray, places[0])


def places_alike(
    pair: StereoPair, camera: CameraCalibration, pixel: Array, depths_m: tuple[float, float]
) -> tuple[Candidate, ...]:
    """All places in the right picture that look as much like ``pixel`` as the best one, best first.

    None where nothing looks like it.
    """
    ray = np.append(intrinsics.normalised(camera.left, pixel[None])[0], 1.0)
    ends = np.array([_seen_right(camera, ray, 1.0 / depth) for depth in depths_m])
    places, scores = _peaks(pair.right, _template(pair.left, pixel, HALF), ends)
    return _candidates(camera, ray, places[scores > max(scores.max(initial=-1.0) - _MARGIN, _LEAST)])


def refuse_outside(pixel: Array, camera: CameraCalibration) -> None:
    """Raises TargetRefused (``target.outside_picture``) too near to the rim of the left picture."""
    limit = np.array([camera.width, camera.height]) - 1 - _RIM
    if not (np.all(pixel >= _RIM) and np.all(pixel <= limit)):  # also NaN
        raise TargetRefused(
            "target.outside_picture",
            f"target: ({pixel[0]:.1f}, {pixel[1]:.1f}) px, {_RIM} px inside a picture of "
            f"{camera.width} x {camera.height} px are wanted",
        )


def _ambiguous(camera: CameraCalibration, ray: Array, places: Array, why: str) -> TargetRefused:
    return TargetRefused("target.ambiguous", f"target: {why}", _candidates(camera, ray, places[:_MOST_NAMED]))


def _candidates(camera: CameraCalibration, ray: Array, places: Array) -> tuple[Candidate, ...]:
    """What the ``places`` (n, 2) px of the right eye mean on ``ray``, those before the eyes."""
    return tuple(
        Candidate((float(place[0]), float(place[1])), ray / inverse)
        for place in places
        if (inverse := _inverse_depth(camera, ray, place)) > 0.0
    )


def _template(image: Image, pixel: Array, half: int) -> Image:
    u, v = np.rint(pixel).astype(int)
    reach = half + _BLURRED
    rows, columns = slice(max(v - reach, 0), v + reach + 1), slice(max(u - reach, 0), u + reach + 1)
    return np.asarray(cv2.GaussianBlur(image[rows, columns], (5, 5), 1.0), dtype=np.uint8)


def _peaks(image: Image, template: Image, ends: Array) -> tuple[Array, Array]:
    """Places (n, 2) between the ``ends`` (2, 2) at which the template is found, and scores, best first."""
    height, width = image.shape
    reach_y, reach_x = template.shape[0] // 2, template.shape[1] // 2
    low, high = np.floor(ends.min(axis=0)).astype(int), np.ceil(ends.max(axis=0)).astype(int)
    left, right = max(low[0] - reach_x - 2, 0), min(high[0] + reach_x + 3, width)
    top, bottom = max(low[1] - reach_y - _ROWS, 0), min(high[1] + reach_y + _ROWS + 1, height)
    if right - left < template.shape[1] or bottom - top < template.shape[0]:
        return np.zeros((0, 2)), np.zeros(0)
    strip = cv2.GaussianBlur(image[top:bottom, left:right], (5, 5), 1.0)
    scores = cv2.matchTemplate(strip, template, cv2.TM_CCOEFF_NORMED)
    rows, best = scores.argmax(axis=0), scores.max(axis=0)
    wide = cv2.dilate(best[None], np.ones((1, 2 * _APART + 1), np.uint8))[0]
    columns = np.flatnonzero((best >= wide) & np.isfinite(best))
    columns = columns[np.argsort(-best[columns], kind="stable")]
    places = np.column_stack([columns + left + reach_x, rows[columns] + top + reach_y]).astype(np.float64)
    return places, best[columns].astype(np.float64)


def _way_back(pixel: Array, ends: Array) -> Array:
    """The search in the left picture: as far to either side as the right one was searched."""
    reach = np.array([float(np.ptp(ends[:, 0])), 0.0])
    return np.array([pixel - reach, pixel + reach])


def _seen_right(camera: CameraCalibration, ray: Array, inverse_depth: float) -> Array:
    """The right eye's pixel (2,) of the point on a ray of the left eye."""
    return np.asarray(right_pixels(camera.right, ray[None], np.array([inverse_depth]))[0])


def right_pixels(eye: CameraModel, rays: Array, inverse_depths: Array) -> Array:
    """Pixels (n, 2) at which ``eye`` sees the points of C on ``rays`` (n, 3) with z = 1."""
    X_EC = se3.inverse(eye.X_CE)
    scaled = rays @ X_EC[:3, :3].T + inverse_depths[:, None] * X_EC[:3, 3]
    return np.asarray(intrinsics.distorted(eye, scaled[:, :2] / scaled[:, 2:]))


def depth_of(camera: CameraCalibration, left_px: Array, right_px: Array) -> float:
    """Depth (m) of the point that the eyes see at these pixels. Raises TargetRefused for none before them."""
    ray = np.append(intrinsics.normalised(camera.left, left_px[None])[0], 1.0)
    inverse = _inverse_depth(camera, ray, right_px)
    if not inverse > 1e-3:
        raise TargetRefused(
            "target.ambiguous", "target: the clicks in the two eyes mean no point before them"
        )
    return 1.0 / inverse


def _inverse_depth(camera: CameraCalibration, ray: Array, right_px: Array) -> float:
    """1/m of the point of ``ray`` that the right eye sees in the column of ``right_px``."""
    a, b = 0.2, 2.0  # 1/m; columns are all but linear in between
    for _ in range(3):
        u_a, u_b = _seen_right(camera, ray, a)[0], _seen_right(camera, ray, b)[0]
        a, b = b, a + (b - a) * (right_px[0] - u_a) / (u_b - u_a)
        if abs(b - a) < 1e-9:
            break
    return float(b)
