"""Whether a board is the one that was asked for: its counts, and whether it has an up and a down."""

from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np

from protocol.errors import RequestRefused
from testbed.reporting.console import out
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard
from vision_pc.core.types import Image

_LOOKED_AT = 5
_SMALLEST = (3, 3)


def counts_shown(pictures: Sequence[Image]) -> tuple[int, int] | None:
    """The inner corners, more by fewer, of the checkerboard that most of a few pictures show whole; None
    where they do not agree.
    """
    chosen = np.unique(np.linspace(0, len(pictures) - 1, min(_LOOKED_AT, len(pictures))).round().astype(int))
    seen: Counter[tuple[int, int]] = Counter()
    for k in chosen:
        found, _, meta = cv2.findChessboardCornersSBWithMeta(pictures[k], _SMALLEST, cv2.CALIB_CB_LARGER)
        if found and min(meta.shape) > min(_SMALLEST):  # so few corners are in any texture
            seen[max(meta.shape), min(meta.shape)] += 1
    most = seen.most_common(1)
    return most[0][0] if most and 2 * most[0][1] > seen.total() else None


def question(pictures: Sequence[Image], board: Checkerboard | Charuco, found: int) -> None:
    """Say what is doubtful about ``board``, of which ``found`` pictures show one.

    Raises RequestRefused (``refused.board.counts``) where another one is there, and none is found, or
    ``board`` is but a part of it: it may be another part in every picture.
    """
    if isinstance(board, Charuco):
        return
    asked = (max(board.columns, board.rows), min(board.columns, board.rows))
    shown = counts_shown(pictures)
    if shown is not None and shown != asked:
        why = (
            f"the pictures show a board of {shown[0]}x{shown[1]} inner corners, asked for are "
            f"{board.columns}x{board.rows}: --columns and --rows count corners where four squares meet, "
            "one fewer than squares each way"
        )
        if not found or (shown[0] >= asked[0] and shown[1] >= asked[1]):
            raise RequestRefused("refused.board.counts", why)
        out.print(why, style="yellow", highlight=False, soft_wrap=True)
    if (board.columns + board.rows) % 2 == 0:
        out.print(
            f"a board of {board.columns}x{board.rows} corners looks the same half a turn on: its upper edge "
            "must be up in every picture; one of 9x6 may be held anyhow",
            style="yellow", highlight=False, soft_wrap=True,
        )  # fmt: skip
