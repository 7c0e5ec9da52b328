"""Pictures of square markers whose corners are known exactly: ink and paper integrated over each pixel.

A marker lies in the middle of its tile; the camera looks at its centre, so that the angle is that of the line
of sight against its normal. Light, paper, ground and turn are drawn; side, angle, blur and noise are asked.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from foundation.compiled import kernel
from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

WIDTH, HEIGHT = 1280, 720
COLUMNS, LINES = 6, 3
FOCAL_PX = 530.0  # a ZED2's, 720p: what perspective there is across a marker
_MIDDLE = 2  # blurred at half pixels,
_FINE = 4  # of which each has so many samples along each axis
_PAPER, _INK = 200.0, 30.0  # grey levels
_QUIET = 1.0  # cells of paper around the border: what standards ask for
_CLUTTER = 40


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


def tags(
    dictionary: str, aspect: MarkerAspect, rng: np.random.Generator, count: int = COLUMNS * LINES
) -> TagPicture:
    """Markers of ``dictionary`` in ``count`` of 6 × 3 tiles of a 720p picture, all numbers different."""
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    numbers = rng.permutation(len(book.bytesList))[:count]
    ground = _ground(rng)
    corners: dict[int, Array] = {}
    for k, number in enumerate(numbers):
        tile = np.array([WIDTH / COLUMNS, HEIGHT / LINES])
        centre = (np.array([k % COLUMNS, k // COLUMNS]) + 0.5) * tile + rng.uniform(-20.0, 20.0, 2)
        corners[int(number)] = _laid(ground, _cells(book, int(number)), centre, aspect, rng)
    return TagPicture(_expose(ground, aspect, rng), corners)


def clutter(aspect: MarkerAspect, rng: np.random.Generator) -> Image:
    """A 720p picture without markers: dark and bright quadrangles, half of them of random cells."""
    ground = _ground(rng)
    for _ in range(_CLUTTER):
        cells = np.full((9, 9), float(rng.uniform(20.0, 230.0)))
        if rng.random() < 0.5:
            count = int(rng.integers(4, 11))
            cells = np.where(rng.random((count, count)) < 0.5, _INK, _PAPER)
        if rng.random() < 0.5:
            cells = np.pad(np.pad(cells, 1, constant_values=_INK), 1, constant_values=_PAPER)
        at = rng.uniform((60.0, 60.0), (WIDTH - 60.0, HEIGHT - 60.0))
        seen = aspect._replace(side_px=float(rng.uniform(12, 90)), angle_deg=float(rng.uniform(0, 65)))
        _laid(ground, cells, at, seen, rng, 0.0)
    return _expose(ground, aspect, rng)


def _ground(rng: np.random.Generator) -> Array:
    """Texture of four octaves on mean light: (720, 1280), grey levels."""
    ground = np.full((HEIGHT, WIDTH), float(rng.uniform(70.0, 150.0)))
    for octave in range(4):
        step = 4 << octave
        small = rng.normal(0.0, 8.0, (HEIGHT // step + 2, WIDTH // step + 2))
        ground += cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return ground


def _cells(book: cv2.aruco.Dictionary, number: int) -> Array:
    """Ink and paper of a marker, black border included, as grey levels."""
    count = book.markerSize + 2
    return np.where(book.generateImageMarker(number, count) > 0, _PAPER, _INK)


def _laid(
    ground: Array,
    cells: Array,
    centre: Array,
    aspect: MarkerAspect,
    rng: np.random.Generator,
    quiet: float = _QUIET,
) -> Array:
    """Lay ``cells`` with ``quiet`` cells of paper around into ``ground``; the corners (4, 2) px."""
    H = _view(centre, aspect, rng)
    count = len(cells)
    paper = 0.5 + quiet / count
    outline = _apply_homography(H, paper * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
    reach = 4.0 * aspect.blur_px + 2.0
    x0, y0 = np.maximum(np.floor(outline.min(axis=0) - reach), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(outline.max(axis=0) + reach), (WIDTH - 1, HEIGHT - 1)).astype(int)
    place = ground[y0:y1, x0:x1]
    light = np.array([rng.uniform(0.75, 1.1), *rng.uniform(-0.15, 0.15, 2)])
    size = (y1 - y0, x1 - x0)
    back = np.asarray(np.linalg.inv(H), dtype=np.float64)
    cover, shown = (
        _blur(fine, aspect.blur_px)
        for fine in _integrate_cells(back, cells, (x0 - 0.5, y0 - 0.5), size, (paper, *light))
    )
    place[:] = (1.0 - cover) * place + shown
    return _apply_homography(H, np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]))


@kernel(nogil=True)
def _integrate_cells(
    back: Array,
    cells: Array,
    corner: tuple[float, float],
    size: tuple[int, int],
    sheet: tuple[float, float, float, float],
) -> tuple[Array, Array]:
    """The share of paper in each half pixel of a window, and its light, (2 rows, 2 columns) each.

    ``back``: pixels to the marker's plane; ``corner``: x, y of the window's outer corner; ``size``: its rows
    and columns; ``sheet``: half the paper's side, its light in the middle, and how that grows along x and y.
    """
    paper, middle, along_x, along_y = sheet
    rows, columns, count = _MIDDLE * size[0], _MIDDLE * size[1], len(cells)
    cover, shown = np.zeros((rows, columns)), np.zeros((rows, columns))
    each, step = 1.0 / (_FINE * _FINE), 1.0 / (_MIDDLE * _FINE)
    for i in range(rows):
        for j in range(columns):
            for k in range(_FINE * _FINE):
                u = corner[0] + (j * _FINE + k % _FINE + 0.5) * step
                v = corner[1] + (i * _FINE + k // _FINE + 0.5) * step
                w = back[2, 0] * u + back[2, 1] * v + back[2, 2]
                x = (back[0, 0] * u + back[0, 1] * v + back[0, 2]) / w
                y = (back[1, 0] * u + back[1, 1] * v + back[1, 2]) / w
                away = max(abs(x), abs(y))
                if away > paper:
                    continue
                cover[i, j] += each
                grey = _PAPER
                if away < 0.5:
                    grey = cells[int((y + 0.5) * count), int((x + 0.5) * count)]
                shown[i, j] += each * grey * middle * (1.0 + along_x * x + along_y * y)
    return cover, shown


def _blur(halves: Array, blur_px: float) -> Array:
    """Blurred, then integrated over whole pixels."""
    soft = cv2.GaussianBlur(halves, (0, 0), _MIDDLE * blur_px) if blur_px > 0.0 else halves
    size = (halves.shape[1] // _MIDDLE, halves.shape[0] // _MIDDLE)
    return np.asarray(cv2.resize(soft, size, interpolation=cv2.INTER_AREA), dtype=np.float64)


def _view(centre: Array, aspect: MarkerAspect, rng: np.random.Generator) -> Array:
    """Homography from the marker's plane (side 1, y down) to pixels: tilted about a drawn axis, turned."""
    axis, turn = rng.uniform(0.0, 2.0 * math.pi, 2)
    tilt = se3.exp_so3(math.radians(aspect.angle_deg) * np.array([math.cos(axis), math.sin(axis), 0.0]))
    R = tilt @ se3.exp_so3(np.array([0.0, 0.0, turn]))
    away = np.array([0.0, 0.0, FOCAL_PX / aspect.side_px])
    K = np.array([[FOCAL_PX, 0.0, centre[0]], [0.0, FOCAL_PX, centre[1]], [0.0, 0.0, 1.0]])
    return np.asarray(K @ np.column_stack([R[:, 0], R[:, 1], away]))


def _apply_homography(H: Array, points: Array) -> Array:
    homogeneous = np.column_stack([points, np.ones(len(points))]) @ H.T
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def _expose(ground: Array, aspect: MarkerAspect, rng: np.random.Generator) -> Image:
    noisy = ground + rng.normal(0.0, aspect.noise_grey, ground.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)
