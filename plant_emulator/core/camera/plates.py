"""Flat plates, of which everything visible but the wall is made: grids of cells, or printed pictures."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]
Matrix = NDArray[np.float64]

_COARSEST_TEXELS = 8


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
    """A flat or slightly bent rectangle painted with a grid of uniform cells, or with a picture.

    ``X_parent_plate``: pose in the parent (O for the wall's markers, M for what the tool carries), x right, y
    up, z towards the viewer. ``edges_x`` and ``edges_y`` are the grid lines in metres, ascending; y here
    counts **downwards**, so that ``grey[row, column]`` reads like a picture. ``lit_by_wall``: the wall's
    lighting gradient applies. ``levels``: the picture that fills the rectangle instead of ``grey``, and its
    mip levels, each half as fine as the one before; always flat and matt. ``glossy``: a lamp is mirrored.
    """

    X_parent_plate: Matrix
    edges_x: Matrix
    edges_y: Matrix
    grey: NDArray[np.float32]
    lit_by_wall: bool
    levels: tuple[Grey, ...] = ()
    bend: Bend = FLAT
    glossy: bool = False


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


def picture_plate(X_parent_plate: Matrix, texel_m: float, picture: Grey, lit_by_wall: bool) -> Plate:
    """A plate that shows ``picture`` with texels of ``texel_m``, its middle at the origin of its pose."""
    half_y, half_x = (0.5 * texel_m * count for count in picture.shape)
    levels = [picture]
    while min(levels[-1].shape) >= 2 * _COARSEST_TEXELS and not any(side % 2 for side in levels[-1].shape):
        coarser = cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(coarser, dtype=np.uint8))
    plain = np.zeros((1, 1), dtype=np.float32)
    edges_x, edges_y = np.array([-half_x, half_x]), np.array([-half_y, half_y])
    return Plate(X_parent_plate, edges_x, edges_y, plain, lit_by_wall, tuple(levels))
