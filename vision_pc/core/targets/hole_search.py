"""Dark round spots of the left picture that may be holes: dark against their surroundings, and compact."""

import cv2
import numpy as np

from vision_pc.core.se3 import Array
from vision_pc.core.targets.round_edge import DarkSpot
from vision_pc.core.types import Image

_SURROUNDINGS_PX = 101
_LEVELS = (0.62, 0.5, 0.38, 0.26)  # of the surroundings' brightness below which a pixel is dark
_LEAST_RADIUS, _MOST_RADIUS = 3.0, 60.0  # px
_LEAST_FILL = 0.55  # of the rectangle about it that a disc fills: 0.79
_MOST_STRETCH = 2.2


def dark_spots(image: Image, region: tuple[int, int, int, int] | None = None) -> list[DarkSpot]:
    """Dark round spots, each once in its most compact form; ``region`` (left, top, right, bottom) px."""
    left, top, right, bottom = region or (0, 0, image.shape[1], image.shape[0])
    part = np.ascontiguousarray(image[top:bottom, left:right])
    if min(part.shape) < 8:
        return []
    around = cv2.blur(part, (_SURROUNDINGS_PX, _SURROUNDINGS_PX), borderType=cv2.BORDER_REFLECT)
    smooth = cv2.GaussianBlur(part, (3, 3), 0.8)
    found: list[tuple[float, DarkSpot]] = []
    for level in _LEVELS:
        dark = (smooth.astype(np.float32) < level * around).astype(np.uint8)
        count, _, stats, centroids = cv2.connectedComponentsWithStats(dark, connectivity=4)
        for k in range(1, count):
            compact, spot = _spot(stats[k], centroids[k] + np.array([left, top]))
            if compact > 0.0:
                found.append((compact, spot))
    kept: list[DarkSpot] = []
    for _, spot in sorted(found, key=lambda each: -each[0]):
        if all(np.linalg.norm(spot.middle - other.middle) > 0.7 * other.radius for other in kept):
            kept.append(spot)
    return kept


def _spot(stats: Array, middle: Array) -> tuple[float, DarkSpot]:
    """How compact a component is, 0 for what is no disc, and the spot that it makes."""
    width, height, area = float(stats[2]), float(stats[3]), float(stats[4])
    radius = (area / np.pi) ** 0.5
    fill, stretch = area / (width * height), max(width, height) / min(width, height)
    disc = _LEAST_RADIUS <= radius <= _MOST_RADIUS and fill >= _LEAST_FILL and stretch <= _MOST_STRETCH
    return fill / stretch if disc else 0.0, DarkSpot(np.asarray(middle, dtype=np.float64), float(radius))
