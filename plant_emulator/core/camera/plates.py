"""Plates of cells, of which everything visible but the wall is made, and where they appear in one eye's
picture, all those of a parent at once.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core.camera.rays import Lens

Matrix = NDArray[np.float64]
Pixels = NDArray[np.int64]

Box = tuple[int, int, int, int]

_RIM_PX = 2  # a plate's rim touches pixels this far outside its projected corners
_NEAREST_M = 0.02
_ASIDE = 1.05  # of the widest rays: farther aside nothing is seen, not even a rim
_ALONG = 8  # points on each side of a plate, where the lens bends straight lines


WHITE_GREY, _BLACK_GREY = 208.0, 22.0  # [E] of print on paper


def printed_greys(white: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The grey of each cell of a print."""
    return np.where(white, WHITE_GREY, _BLACK_GREY).astype(np.float32)


class Bend(NamedTuple):
    """A cylindrical bend: z = ``curve`` (1/m) times the square of the way along (``across``, ``up``)."""

    curve: float = 0.0
    across: float = 1.0
    up: float = 0.0

    def height(self, x: Matrix, y: Matrix) -> Matrix:
        """z (m) of the surface at x right and y up (m)."""
        return np.asarray(self.curve * (self.across * x + self.up * y) ** 2)


FLAT = Bend()


class Plate(NamedTuple):
    """A flat or slightly bent rectangle painted with a grid of uniform cells.

    ``X_parent_plate``: pose in the parent (O for the wall's markers, M for what the tool carries), x right, y
    up, z towards the viewer. ``edges_x`` and ``edges_y`` are the grid lines in metres, ascending; y here
    counts **downwards**, so that ``grey[row, column]`` reads like a picture. ``lit_by_wall``: the wall's
    lighting gradient applies.
    """

    X_parent_plate: Matrix
    edges_x: Matrix
    edges_y: Matrix
    grey: NDArray[np.float32]
    lit_by_wall: bool
    bend: Bend = FLAT


def plain_plate(
    X_parent_plate: Matrix,
    edges_x: tuple[float, float],
    edges_y: tuple[float, float],
    grey: float,
    lit_by_wall: bool = False,
) -> Plate:
    """A plate of one grey between two edges across and two edges down, in metres."""
    cell = np.full((1, 1), grey, dtype=np.float32)
    return Plate(X_parent_plate, np.array(edges_x), np.array(edges_y), cell, lit_by_wall)


def grid_plate(X_parent_plate: Matrix, cell_m: float, grey: NDArray[np.float32], lit_by_wall: bool) -> Plate:
    """A plate of square cells of ``cell_m``, its middle at the origin of its pose."""
    edges_y, edges_x = (np.arange(count + 1) * cell_m - 0.5 * count * cell_m for count in grey.shape)
    return Plate(X_parent_plate, edges_x, edges_y, grey, lit_by_wall)


class Sheets(NamedTuple):
    """Plates of one parent, and what about them never changes.

    ``poses`` (n, 4, 4) in the parent; ``rims`` (n, 8, 3) the corners on the plate's plane and on its bent
    surface; ``lights`` (n, 3) as ``rays.Surface`` takes them.
    """

    plates: tuple[Plate, ...]
    poses: Matrix
    rims: Matrix
    lights: Matrix


class Placed(NamedTuple):
    """A plate that may be seen: its number among the sheets, and the pixels that it may touch.

    ``box`` (top, bottom, left, right), half open; ``homographies`` (2, 3, 3) from rays to the plate, at the
    picture's first and last row; ``eye_P`` (3,) the eye in the plate's axes, the mean over the rows.
    """

    number: int
    box: Box
    homographies: Matrix
    eye_P: Matrix


def sheets(plates: tuple[Plate, ...], gradient_per_m: tuple[float, float]) -> Sheets:
    """``plates`` of one parent; the wall's lighting changes by ``gradient_per_m`` to the right and up."""
    gradient = np.array(gradient_per_m)
    rims, lights = np.empty((len(plates), 8, 3)), np.tile([1.0, 0.0, 0.0], (len(plates), 1))
    for k, plate in enumerate(plates):
        x0, x1, y0, y1 = plate.edges_x[0], plate.edges_x[-1], -plate.edges_y[-1], -plate.edges_y[0]
        rims[k, :4] = rims[k, 4:] = [[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]]
        rims[k, 4:, 2] = plate.bend.height(rims[k, :4, 0], rims[k, :4, 1])
        if plate.lit_by_wall:
            R, p = plate.X_parent_plate[:2, :2], plate.X_parent_plate[:2, 3]
            lights[k] = 1.0 + gradient @ p, gradient @ R[:, 0], -(gradient @ R[:, 1])
    poses = np.array([plate.X_parent_plate for plate in plates]).reshape(-1, 4, 4)
    return Sheets(plates, poses, rims, lights)


def placed(
    rims: Matrix, X_EPs: Matrix, lens: Lens, size: tuple[int, int], widest: Matrix
) -> Iterator[Placed]:
    """The plates that may be seen, in their order.

    ``rims`` (n, 8, 3) as in Sheets; ``X_EPs`` (n, m, 4, 4) the plates in the eye at the instants of the first
    and the last row, or of all; ``size`` (width, height); ``widest`` (4,) of the eye's normalised rays: least
    and greatest x and y.
    """
    R, p = X_EPs[..., :3, :3], X_EPs[..., :3, 3]
    around = _outlines(rims) if lens.bends else rims
    in_eye = around[:, None] @ np.swapaxes(R, -1, -2) + p[:, :, None]
    boxes = _boxes(in_eye, X_EPs, lens, size, widest)
    numbers = np.flatnonzero((boxes[:, 0] < boxes[:, 1]) & (boxes[:, 2] < boxes[:, 3]))
    boxes, R, p = boxes[numbers], R[numbers], p[numbers]
    homographies = ray_to_plane(X_EPs[numbers])
    eyes_P = -(np.swapaxes(R, -1, -2) @ p[..., None])[..., 0].mean(axis=1)
    for k, number in enumerate(numbers.tolist()):
        top, bottom, left, right = boxes[k].tolist()
        yield Placed(number, (top, bottom, left, right), homographies[k][[0, -1]], eyes_P[k])


def ray_to_plane(X_EP: Matrix) -> Matrix:
    """Homographies (..., 3, 3) from a normalised ray (x, y, 1) to coordinates (x right, y down) on z_P = 0.

    ``X_EP`` (..., 4, 4). The third component is 1/depth: positive where the ray meets the plane in front.
    """
    columns = np.stack([X_EP[..., :3, 0], -X_EP[..., :3, 1], X_EP[..., :3, 3]], axis=-1)
    return np.asarray(np.linalg.inv(columns), dtype=np.float64)


def _outlines(rims: Matrix) -> Matrix:
    """Points (n, 8 m, 3) along the sides of plates whose corners are ``rims`` (n, 8, 3)."""
    squares = rims.reshape(-1, 2, 4, 1, 3)
    share = np.linspace(0.0, 1.0, _ALONG, endpoint=False)[:, None]
    sides = squares * (1.0 - share) + np.roll(squares, -1, axis=2) * share
    return np.asarray(sides.reshape(len(rims), -1, 3))


def _boxes(in_eye: Matrix, X_EPs: Matrix, lens: Lens, size: tuple[int, int], widest: Matrix) -> Pixels:
    """Pixel rows and columns (n, 4) that each plate may touch, half open: top, bottom, left, right.

    ``in_eye`` (n, m, k, 3): the points about each at each instant. Empty where there is nothing to see: from
    behind no plate of this scene has anything to show, and what has all its points beyond a plane through the
    eye and a side of the picture is beside it. All of the picture where some points are too near.
    """
    x, y, z = np.moveaxis(in_eye, -1, 0)
    near = z <= _NEAREST_M
    least_x, most_x, least_y, most_y = (_ASIDE * extreme * z for extreme in widest)
    beside = [(x < least_x), (x > most_x), (y < least_y), (y > most_y), near]
    hidden = np.any([one.all(axis=2) for one in beside], axis=0).all(axis=1)
    hidden |= ((X_EPs[..., :3, 2] * X_EPs[..., :3, 3]).sum(axis=-1) >= 0.0).any(axis=1)
    pixels = lens.project(in_eye.reshape(-1, 3)).reshape(in_eye.shape[0], -1, 2)
    whole = near.any(axis=(1, 2))[:, None]
    low = np.where(whole, 0.0, np.floor(pixels.min(axis=1)) - _RIM_PX)
    high = np.where(whole, size, np.ceil(pixels.max(axis=1)) + _RIM_PX + 1.0)
    edges = np.clip(np.stack([low, high], axis=1), 0.0, size)[..., ::-1].astype(np.int64)
    return np.where(hidden[:, None], 0, np.swapaxes(edges, 1, 2).reshape(-1, 4))
