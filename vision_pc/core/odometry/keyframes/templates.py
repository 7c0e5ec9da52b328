"""What a keyframe's points look like: patches with their gradients, kept while they are looked for."""

import math
from typing import NamedTuple

import numpy as np

from foundation.compiled import allocation_free
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

FLAT = 1e-3  # grey levels, the norm below which a patch has no texture


class Patches(NamedTuple):
    """Square patches of ``side`` px, the rows of each one after the other.

    ``patterns`` (n, 3, side²): the patch of mean 0 and norm 1, and its gradients right and down; ``products``
    (n, 3) the gradients' sums of squares xx, xy, yy; NaN where the picture ends or is flat.
    """

    side: int
    patterns: Array
    products: Array


class Templates:
    """The patches around ``pixels`` (n, 2) of ``image``, made when first asked for.

    One patch is compared with in every picture that shows it, so its gradients are worth keeping: about 10 kB
    a point.
    """

    def __init__(self, image: Image, pixels: Array, side: int) -> None:
        self._image = image
        self._pixels = pixels
        self._side = side
        self._patches: Patches | None = None

    def patches(self) -> Patches:
        """Those of all pixels."""
        if self._patches is None:
            count, side = len(self._pixels), self._side
            self._patches = Patches(side, np.zeros((count, 3, side * side)), np.full((count, 3), np.nan))
            _make(self._image, self._pixels, self._patches)
        return self._patches

    def forget(self) -> None:
        """Let the patches go until they are asked for again."""
        self._patches = None


@allocation_free
def is_inside(image: Image, x: float, y: float, warp: tuple[float, float, float, float], half: int) -> bool:
    """Whether a patch around (x, y) under the distortion [[a, b], [c, d]] stays in ``image``."""
    height, width = image.shape
    a, b, c, d = warp
    reach_x, reach_y = half * (abs(a) + abs(b)), half * (abs(c) + abs(d))
    return x - reach_x >= 0.0 and y - reach_y >= 0.0 and x + reach_x < width - 1 and y + reach_y < height - 1


@allocation_free(nogil=True)
def _make(image: Image, pixels: Array, made: Patches) -> None:
    for n in range(len(pixels)):
        patterns = made.patterns[n]
        if _sample(image, pixels[n, 0], pixels[n, 1], made.side, patterns[0]):
            _gradients(patterns, made.side, made.products[n])


@allocation_free(inline="always")
def _value(image: Image, column: float, row: float) -> float:
    """The picture's grey level between pixels, bilinear."""
    left, top = int(column), int(row)
    fx, fy = column - left, row - top
    corner = float(image[top, left])
    upper = corner + fx * (float(image[top, left + 1]) - corner)
    corner = float(image[top + 1, left])
    lower = corner + fx * (float(image[top + 1, left + 1]) - corner)
    return upper + fy * (lower - upper)


@allocation_free
def _sample(image: Image, x: float, y: float, side: int, patch: Array) -> bool:
    """Fill ``patch`` from ``image`` around (x, y), of mean 0 and norm 1; False if it leaves it or is flat."""
    half = side // 2
    if not is_inside(image, x, y, (1.0, 0.0, 0.0, 1.0), half):
        return False
    total = squares = 0.0
    for i in range(side):
        for j in range(side):
            value = _value(image, x + (j - half), y + (i - half))
            patch[i * side + j] = value
            total += value
            squares += value * value
    mean = total / (side * side)
    norm = math.sqrt(max(squares - total * mean, 0.0))
    if norm < FLAT:
        return False
    for k in range(side * side):
        patch[k] = (patch[k] - mean) / norm
    return True


@allocation_free
def _gradients(patterns: Array, side: int, products: Array) -> None:
    """Fill the gradients of the patch, and their sums of squares xx, xy, yy.

    Central differences, zero at the rim, without what only changes brightness or contrast: orthogonal to 1
    and to the patch, which is the derivative of a patch that is kept at mean 0 and norm 1.
    """
    for i in range(1, side - 1):
        for j in range(1, side - 1):
            k = i * side + j
            patterns[1, k] = 0.5 * (patterns[0, k + 1] - patterns[0, k - 1])
            patterns[2, k] = 0.5 * (patterns[0, k + side] - patterns[0, k - side])
    count = side * side
    for g in range(1, 3):
        mean = along = 0.0
        for k in range(count):
            mean += patterns[g, k] / count
        for k in range(count):
            along += (patterns[g, k] - mean) * patterns[0, k]
        for k in range(count):
            patterns[g, k] -= mean + patterns[0, k] * along
    for m, (p, q) in enumerate(((1, 1), (1, 2), (2, 2))):
        products[m] = 0.0
        for k in range(count):
            products[m] += patterns[p, k] * patterns[q, k]
