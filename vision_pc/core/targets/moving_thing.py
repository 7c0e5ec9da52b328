"""Whether what was clicked has moved since the picture that was clicked, for a camera that stands still."""

import math

import cv2
import numpy as np

from vision_pc.core.se3 import Array
from vision_pc.core.targets.target import TargetRefused
from vision_pc.core.types import Image

_HALF = 20  # px of what is compared, on either side
_REACH = 18  # px it is looked for about its place; both together lie within the rim that no click may be in
_MOST_PX = 2.0  # [E] that a disabled arm sinks in the seconds that a picture is kept for
_LEAST = 0.5  # correlation below which something else is there
_MARGIN = 0.1  # by which another place must look more alike than its own


def refuse_moved(then: Image, now: Image, pixel: Array) -> None:
    """Raises TargetRefused (``target.moves``) where ``now`` shows at ``pixel`` (2,) not what ``then`` does.

    ``pixel`` is no nearer to the rim than a click may be, and was measured: there is something to compare.
    """
    u, v = np.rint(pixel).astype(int)
    wide = _HALF + _REACH
    template = _smooth(then[v - _HALF : v + _HALF + 1, u - _HALF : u + _HALF + 1])
    scores = cv2.matchTemplate(
        _smooth(now[v - wide : v + wide + 1, u - wide : u + wide + 1]), template, cv2.TM_CCOEFF_NORMED
    )
    row, column = np.unravel_index(int(scores.argmax()), scores.shape)
    best, moved = float(scores[row, column]), math.hypot(row - _REACH, column - _REACH)
    here = float(scores[_REACH - 2 : _REACH + 3, _REACH - 2 : _REACH + 3].max())
    if best < _LEAST:
        raise TargetRefused("target.moves", "target: something else is there by now")
    if moved > _MOST_PX and here < best - _MARGIN:
        raise TargetRefused("target.moves", f"target: what is there has moved by {moved:.0f} px since")


def _smooth(image: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (5, 5), 1.0), dtype=np.uint8)
