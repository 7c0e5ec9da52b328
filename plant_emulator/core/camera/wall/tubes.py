"""Tubes that stand out of the wall, as in a rack of charging tubes: painted over the picture pixel by pixel.

Of a tube an eye sees its side, the ring of its front rim, and through the mouth what is inside: the rim lies
nearer than the wall, so that it stands elsewhere before the wall for each eye.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.config.surroundings import TubeConfig
from plant_emulator.core.camera.lens import Lens
from plant_emulator.core.camera.rasteriser import share_below
from plant_emulator.core.camera.rays import PlatePoint, Rays, meet_plate, row_homography, shaded
from plant_emulator.core.camera.wall.bores import View, grey_inside, scatter

Grey = NDArray[np.uint8]
Matrix = NDArray[np.float64]

_LIT = 0.4  # of the side's grey that the tube's inner wall has at the mouth
_NEAREST_M = 0.05
_CELL_M = 0.006  # of the stains on side and rim


class Tube(NamedTuple):
    """A tube's numbers, the first seven as of ``bores.Bore``: place right, down; inner radius; depth; greys
    of bottom, rim and inner wall; then outer radius, length before the wall, grey of the side.
    """

    shape: Matrix


def tube(config: TubeConfig) -> Tube:
    """The tube as it is painted."""
    x, y = config.centre_m
    radius = 0.0005 * config.diameter_mm
    return Tube(
        np.array(
            [x, -y, radius, config.depth_m, config.grey, config.rim_grey, _LIT * config.side_grey,
             radius + 0.001 * config.wall_mm, config.length_m, config.side_grey]
        )
    )  # fmt: skip


def paint(picture: Grey, rays: Rays, tubes: tuple[Tube, ...], seen: View, X_EO: Matrix, lens: Lens) -> None:
    """Paint the tubes as far as they are in ``picture``; ``X_EO`` (4, 4) places them in it."""
    height, width = picture.shape
    for one in tubes:
        x, down, outer, length = one.shape[[0, 1, 7, 8]]
        ends = np.array([[x, -down, 0.0], [x, -down, length]]) @ X_EO[:3, :3].T + X_EO[:3, 3]
        if ends[:, 2].min() < _NEAREST_M + outer or seen.eye[2] < length + _NEAREST_M:
            continue
        places = lens.project(ends)
        across = 1.5 * outer * float(lens.focal.max()) / (ends[:, 2].min() - outer) + 4.0
        if not np.isfinite(places).all():
            continue
        low, high = np.floor(places.min(axis=0) - across), np.ceil(places.max(axis=0) + across) + 1.0
        left, top = np.clip(low, 0, (width, height)).astype(int).tolist()
        right, bottom = np.clip(high, 0, (width, height)).astype(int).tolist()
        if top < bottom and left < right:
            _paint(picture, rays, one, seen, (top, bottom, left, right), np.empty((3, 3)))


@allocation_free(nogil=True)
def _paint(
    picture: Grey, rays: Rays, one: Tube, seen: View, box: tuple[int, int, int, int], h: Matrix
) -> None:
    shape, eye = one.shape, seen.eye
    for i in range(box[0], box[1]):
        row_homography(seen.homographies, i, picture.shape[0], h)
        for j in range(box[2], box[3]):
            at = meet_plate(rays, h, i, j)
            if not at.in_front:
                continue
            # From where the ray meets the wall up to the height of the rim, about the tube's axis.
            x0, y0 = at.s - shape[0], at.t - shape[1]
            rise = shape[8] / eye[2]
            x1, y1 = x0 + (eye[0] - at.s) * rise, y0 + (eye[1] - at.t) * rise
            up = _nearest(x0, y0, x1 - x0, y1 - y0)
            near = _covered(x0 + up * (x1 - x0), y0 + up * (y1 - y0), shape[7], 1.0 - up * rise, at)
            if near <= 0.0:
                continue
            lit = seen.light[0] + seen.light[1] * at.s + seen.light[2] * at.t
            lit *= shaded(at.s, at.t, seen.shadow)
            grey = np.float64(picture[i, j])
            grey += near * (_side(x0, y0, x1 - x0, y1 - y0, shape) * lit - grey)
            rim = _covered(x1, y1, shape[7], 1.0 - rise, at)
            if rim > 0.0:
                turn = math.floor(math.atan2(y1, x1) * shape[7] / _CELL_M)
                grey += rim * (shape[5] * (0.94 + 0.12 * scatter(turn, 3.0)) * lit - grey)
                mouth = _covered(x1, y1, shape[2], 1.0 - rise, at)
                if mouth > 0.0:
                    grey += mouth * (grey_inside(x1, y1, at.s, at.t, shape, eye) * lit - grey)
            picture[i, j] = np.uint8(min(max(grey, 0.0), 255.0) + 0.5)


@allocation_free(inline="always")
def _nearest(x: float, y: float, dx: float, dy: float) -> float:
    """The share 0…1 of the way (dx, dy) from (x, y) at which the axis is nearest."""
    way = dx * dx + dy * dy
    return min(max(-(x * dx + y * dy) / way, 0.0), 1.0) if way > 1e-18 else 1.0


@allocation_free(inline="always")
def _covered(x: float, y: float, radius: float, scale: float, at: PlatePoint) -> float:
    """The share of a pixel within ``radius`` of the axis; ``scale``: its footprint over that on the wall."""
    far = max(math.hypot(x, y), 1e-9)
    a = scale * abs(x * at.s_u + y * at.t_u) / far
    b = scale * abs(x * at.s_v + y * at.t_v) / far
    return share_below(radius - far, max(a, b, 1e-9), max(min(a, b), 1e-12))


@allocation_free(inline="always")
def _side(x: float, y: float, dx: float, dy: float, shape: Matrix) -> float:
    """The grey of the side where the ray from (x, y) at the wall to the rim's height comes out of it."""
    a, b, c = dx * dx + dy * dy, x * dx + y * dy, x * x + y * y - shape[7] * shape[7]
    up = 0.0
    if a > 1e-18:
        up = min(max((-b + math.sqrt(max(b * b - a * c, 0.0))) / a, 0.0), 1.0)
    x, y = x + up * dx, y + up * dy
    far = max(math.hypot(x, y), 1e-9)
    stain = scatter(math.floor(math.atan2(y, x) * shape[7] / _CELL_M), math.floor(up * shape[8] / _CELL_M))
    # Brighter from above, darker towards the wall.
    return float(shape[9] * (0.75 - 0.2 * y / far) * (0.6 + 0.4 * up) * (0.85 + 0.3 * stain))
