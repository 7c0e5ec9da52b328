"""The tool's outline, by which the place of its marker is known when the marker itself cannot be seen.

Tool and camera sit on the same link, so in the pictures the tool stands still while the world moves behind
it. While the marker is seen, its corners are remembered, and where straight pieces of the tool's outline lie.
Later the pieces are found again: by as much as they have moved, in both eyes, the corners have.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.config.vision import ToolMarkerSettings
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel, Image, StereoPair, ToolMemory, ToolPieces

_PIECE_PX = 24.0  # along the outline: so many pixels tell one place together
_SHORTEST_PX = 14.0
_TAUGHT_REACH = 8  # px: a drawing is not the tool
_REACH = 5  # px: a tool that moved by more was not left as it was
_STEP = 0.25  # px across
_SOFT = 1.0  # px: standard deviation of the Gaussian whose slope is laid over a profile
_TAIL = 3.0  # of it, on either side
_CONTRAST = 10.0  # grey levels between both sides
_CLEAR = 1.6  # times as steep as any other place in reach
_FEWEST = 8  # pieces in an eye
_SHARE = 0.5  # of those that were taught must be found
_VAGUE_PX = 0.25  # [D] standard deviation of a shift that is not worth having
_ROUNDS = 6  # of Tukey's weights
_TUKEY = 4.7
_SINGULAR = 1e12  # condition of a fit that means nothing
_FLOOR_PX = 0.03  # [M] of one piece before an even wall
_SPREAD_LIGHT_PX = 0.5  # [E] by which a side looks displaced that has turned from bright to dark
_UNEVEN_PX = 1.3  # [M] the same, where all around is as steep as the edge itself
_CROSSING = 3.0  # pieces, at least, that tell each direction
_MOST = 30  # frames whose mean is remembered


class OutlineShift(NamedTuple):
    """How an outline has moved in a picture: ``shift`` (2,) px of ``about`` (2,) and ``turn`` rad there.

    ``std_px``: of the shift, in its less certain direction.
    """

    shift: Array
    turn: float
    about: Array
    std_px: float

    def moved(self, points: Array) -> Array:
        """Where ``points`` (n, 2) px of the tool are now."""
        away = points - self.about
        return points + self.shift + self.turn * np.column_stack((-away[:, 1], away[:, 0]))


def remembered(
    before: ToolMemory | None,
    pair: StereoPair,
    corners: tuple[Array, Array],
    X_CM: Array,
    tool: ToolMarkerSettings,
    camera: CameraCalibration,
) -> ToolMemory | None:
    """The memory after a frame that shows the marker at ``corners`` (each (4, 2) px) and so the tool at X_CM.

    None where the outline tells too little: too few pieces, or nothing along a direction.
    """
    left, right = corners
    if before is None or np.abs(before.left - left).max() > _REACH:  # new, or put on anew
        outlines = [
            _found_first(image, _drawn(eye, X_CM, tool, image.shape))
            for image, eye in ((pair.left, camera.left), (pair.right, camera.right))
        ]
        if not all(_tells_all(pieces) for pieces in outlines):
            return None
        return ToolMemory(left, right, (outlines[0], outlines[1]), 1)
    gain = 1.0 / min(before.frames + 1, _MOST)
    pieces = tuple(
        _averaged(image, outline, gain)
        for image, outline in zip((pair.left, pair.right), before.outlines, strict=True)
    )
    return ToolMemory(
        before.left + gain * (left - before.left),
        before.right + gain * (right - before.right),
        (pieces[0], pieces[1]),
        before.frames + 1,
    )


def shifts(memory: ToolMemory, pair: StereoPair) -> tuple[OutlineShift, OutlineShift] | None:
    """How the outline has moved in the left and the right eye, None where too little of it
    is found, or its pieces disagree."""
    found = [
        _shift(image, outline)
        for image, outline in zip((pair.left, pair.right), memory.outlines, strict=True)
    ]
    return None if found[0] is None or found[1] is None else (found[0], found[1])


def _drawn(eye: CameraModel, X_CM: Array, tool: ToolMarkerSettings, shape: tuple[int, ...]) -> ToolPieces:
    """ToolPieces of the drawn outline that the picture shows: sides of rectangles, outside all the others."""
    X_EM = se3.inverse(eye.X_CE) @ X_CM
    middles, normals, lengths = [], [], []
    for number, (x0, y0, x1, y1) in enumerate(tool.outline_m):
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        others = [other for k, other in enumerate(tool.outline_m) if k != number]
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            ends = _pixels(eye, X_EM, np.array([a, b]))
            whole = float(np.linalg.norm(ends[1] - ends[0]))
            count = int(whole / _PIECE_PX) if math.isfinite(whole) else 0
            for k in range(count):
                span = a + (b - a) * np.array([[k], [k + 1]]) / count
                p, q = _pixels(eye, X_EM, span)
                if _covered(span.mean(axis=0), others) or not _shown(p, q, shape):
                    continue
                along = (q - p) / np.linalg.norm(q - p)
                middles.append(0.5 * (p + q))
                normals.append(np.array([along[1], -along[0]]))
                lengths.append(float(np.linalg.norm(q - p)))
    found = np.reshape(middles, (-1, 2)), np.reshape(normals, (-1, 2)), np.array(lengths)
    return ToolPieces(*found, np.ones(len(lengths)))


def _pixels(eye: CameraModel, X_EM: Array, places: Array) -> Array:
    """Pixels (n, 2) of ``places`` (n, 2) m in the marker's plane; NaN behind the lens."""
    points = se3.apply(X_EM, np.column_stack((places, np.zeros(len(places)))))
    ahead = np.where(points[:, 2:] > 0.05, points[:, 2:], np.nan)
    return np.asarray(intrinsics.distorted(eye, points[:, :2] / ahead))


def _covered(place: Array, rectangles: list[tuple[float, float, float, float]]) -> bool:
    x, y = place
    return any(x0 - 1e-6 <= x <= x1 + 1e-6 and y0 - 1e-6 <= y <= y1 + 1e-6 for x0, y0, x1, y1 in rectangles)


def _shown(p: Array, q: Array, shape: tuple[int, ...]) -> bool:
    rim = _TAUGHT_REACH + 2.0
    low, high = np.minimum(p, q), np.maximum(p, q)
    inside = (low > rim).all() and high[0] < shape[1] - rim and high[1] < shape[0] - rim
    return bool(inside and np.linalg.norm(q - p) >= _SHORTEST_PX)


def _profiles(image: Image, pieces: ToolPieces, reach: int) -> Array:
    """Light (n, samples) across each piece, every quarter of a pixel, averaged along it."""
    most = reach + _SOFT * _TAIL
    across = np.arange(-most, most + 1e-9, _STEP)
    along = np.column_stack((-pieces.normals[:, 1], pieces.normals[:, 0]))
    count = int(_PIECE_PX)
    places = (np.arange(count) + 0.5) / count - 0.5
    steps = pieces.lengths[:, None, None] * places[None, :, None] * 0.9  # the ends belong to neighbours too
    at = pieces.middles[:, None, None] + across[None, None, :, None] * pieces.normals[:, None, None]
    at = (at + (steps * along[:, None])[:, :, None]).astype(np.float32)
    flat = at.reshape(len(at) * count, len(across), 2)
    light = np.asarray(cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR), dtype=np.float64)
    return np.asarray(light.reshape(len(at), count, len(across)).mean(axis=1))


class _Edges(NamedTuple):
    """Where (n,) px along its normal each piece lies and how certainly, NaN where no edge stands out, and
    whether the light rises (1) or falls (-1) along the normal.
    """

    offsets: Array
    stds: Array
    rises: Array


def _edges(image: Image, pieces: ToolPieces, reach: int) -> _Edges:
    """The pieces as they are in a picture, within ``reach`` px of where they were.

    What stands behind the tool is not even: by as much as the light changes there, an edge is misplaced.
    """
    if len(pieces.middles) == 0:
        return _Edges(np.zeros(0), np.zeros(0), np.zeros(0))
    light = _profiles(image, pieces, reach)
    tail = np.arange(-_SOFT * _TAIL, _SOFT * _TAIL + 1e-9, _STEP)
    slope = tail * np.exp(-0.5 * (tail / _SOFT) ** 2)
    slope /= np.abs(slope).sum() / 2.0  # a step of one grey level is one
    signed = np.array([np.convolve(profile, -slope, "valid") for profile in light])
    places = np.arange(signed.shape[1]) * _STEP - reach
    found, stds, rises = np.full((3, len(signed)), np.nan)
    for k, steep in enumerate(np.abs(signed)):
        best = int(np.argmax(steep))
        near = np.abs(places - places[best]) <= _SOFT * _TAIL
        rest = steep[~near]
        if best in (0, len(steep) - 1) or steep[best] < max(_CONTRAST, _CLEAR * rest.max(initial=0.0)):
            continue
        a, b, c = steep[best - 1 : best + 2]
        found[k] = places[best] + _STEP * 0.5 * (a - c) / min(a - 2.0 * b + c, -1e-9)
        rises[k] = np.sign(signed[k, best])
        stds[k] = math.hypot(_FLOOR_PX, _UNEVEN_PX * math.sqrt(float(np.mean(rest**2))) / steep[best])
    return _Edges(found, stds, rises)


def _found_first(image: Image, drawn: ToolPieces) -> ToolPieces:
    """The pieces of a drawing that the picture shows, where it shows them."""
    edges = _edges(image, drawn, _TAUGHT_REACH)
    seen = np.isfinite(edges.offsets)
    normals = drawn.normals[seen]
    middles = drawn.middles[seen] + edges.offsets[seen, None] * normals
    return ToolPieces(middles, normals, drawn.lengths[seen], edges.rises[seen])


def _averaged(image: Image, outline: ToolPieces, gain: float) -> ToolPieces:
    offsets = np.nan_to_num(_edges(image, outline, _REACH).offsets)
    return outline._replace(middles=outline.middles + gain * offsets[:, None] * outline.normals)


def _tells_all(pieces: ToolPieces) -> bool:
    """Whether the pieces tell a shift in both directions."""
    if len(pieces.middles) < _FEWEST:
        return False
    return bool(np.linalg.eigvalsh(pieces.normals.T @ pieces.normals)[0] > _CROSSING)


def _shift(image: Image, outline: ToolPieces) -> OutlineShift | None:
    """Tukey's fit of shift and turn to the pieces that are found again.

    A side that was brighter than the wall and is darker now looks displaced, for lenses and pixels spread
    light: all such by one unknown.
    """
    edges = _edges(image, outline, _REACH)
    seen = np.isfinite(edges.offsets)
    if np.count_nonzero(seen) < max(_FEWEST, _SHARE * len(seen)):
        return None
    about = outline.middles.mean(axis=0)
    away = outline.middles[seen] - about
    normals, stds = outline.normals[seen], edges.stds[seen]
    lever = normals[:, 1] * away[:, 0] - normals[:, 0] * away[:, 1]
    turned_over = edges.rises[seen] != outline.rises[seen]
    A = np.column_stack((normals, lever, turned_over)) / stds[:, None]
    b = edges.offsets[seen] / stds
    before = np.diag([0.0, 0.0, 0.0, _SPREAD_LIGHT_PX**-2])
    weights, spread = np.ones(len(A)), 1.0
    for _ in range(_ROUNDS):
        information = A.T @ (weights[:, None] * A) + before
        if np.linalg.cond(information) > _SINGULAR:
            return None
        x = np.linalg.solve(information, A.T @ (weights * b))
        residuals = b - A @ x
        spread = max(1.0, 1.4826 * float(np.median(np.abs(residuals))))
        weights = np.maximum(1.0 - (residuals / (_TUKEY * spread)) ** 2, 0.0) ** 2
    covariance = spread**2 * np.linalg.inv(information)
    std_px = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    if std_px > _VAGUE_PX:
        return None
    return OutlineShift(np.asarray(x[:2], dtype=np.float64), float(x[2]), about, std_px)
