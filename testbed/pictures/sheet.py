"""A contact sheet: pairs of small pictures, off and on, each with a caption."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]

COLUMNS = 3
_WIDTH, _HEIGHT = 204, 115  # of one picture
_CAPTION, _GAP = 32, 10
_LEVELS = 12  # of grey, which keeps the file small


class Pair(NamedTuple):
    """What one cell of the sheet shows."""

    title: str
    caption: str
    off: Grey
    on: Grey


def contact_sheet(pairs: Sequence[Pair]) -> Grey:
    """The sheet (height, width) uint8; in each cell the picture without the effect, then with it."""
    wide, high = 2 * _WIDTH + 2 + _GAP, _HEIGHT + _CAPTION + _GAP
    rows = math.ceil(len(pairs) / COLUMNS)
    paper = np.full((rows * high + _GAP, COLUMNS * wide + _GAP), 255, dtype=np.uint8)
    for number, pair in enumerate(pairs):
        top, left = _GAP + number // COLUMNS * high, _GAP + number % COLUMNS * wide
        for text, line, scale in ((pair.title, 11, 0.42), (pair.caption, 26, 0.36)):
            place = (left, top + line)
            cv2.putText(paper, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, 0, 1, cv2.LINE_AA)
        for index, picture in enumerate((pair.off, pair.on)):
            start = left + index * (_WIDTH + 2)
            paper[top + _CAPTION : top + _CAPTION + _HEIGHT, start : start + _WIDTH] = _small(picture)
    return paper


def _small(picture: Grey) -> Grey:
    shrinks = picture.shape[1] > _WIDTH
    small = cv2.resize(
        picture, (_WIDTH, _HEIGHT), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_NEAREST
    )
    step = 255.0 / (_LEVELS - 1)
    return np.asarray(np.rint(np.rint(small / step) * step), dtype=np.uint8)
