"""Two cameras that are triggered alike or not at all: which of their pictures are of one moment."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from protocol.errors import FrameRefused
from vision_pc.core.types import Image, StereoPair

_DOUBTED = 10  # [D] pairs in a row that are too far apart before they are refused
_WINDOW = 31  # [D] pictures whose medians tell the period, and what is between two clocks
_KNOWN = 5  # [D] of these before the clocks' difference is known


class EyePicture(NamedTuple):
    """A picture of one eye: its stamp on the camera's clock, and when it was taken on this machine's."""

    stamp_ns: int
    capture_ns: int
    picture: Image


class PairMatcher:
    """Pairs pictures whose times differ by less than half a period.

    ``apart_ns``: what the two of a pair may be apart. By stamps where both cameras have one clock
    (``common_clock``: PTP); else by how far their stamps' difference is from its median, which is steady for
    cameras that one line triggers and wanders for others. Pairs further apart are left out, and ten in a row
    are refused. ``unpaired``: pictures of one eye that went without.
    """

    def __init__(self, apart_ns: int, *, common_clock: bool) -> None:
        self._apart_ns, self._common = apart_ns, common_clock
        self._waiting: tuple[deque[EyePicture], deque[EyePicture]] = (deque(maxlen=16), deque(maxlen=16))
        self._periods: deque[int] = deque(maxlen=_WINDOW)
        self._differences: deque[int] = deque(maxlen=_WINDOW)
        self._last_ns: list[int | None] = [None, None]
        self._doubted: list[float] = []
        self._number = 0
        self.unpaired = 0

    def add(self, eye: int, picture: EyePicture) -> StereoPair | None:
        """The pair that ``picture`` of ``eye`` (0 left, 1 right) completes, if it does.

        Raises FrameRefused (``measurement.camera.unpaired``) for cameras that are not triggered alike.
        """
        before_ns = self._last_ns[eye]
        self._last_ns[eye] = picture.stamp_ns
        if before_ns is not None and picture.stamp_ns > before_ns:
            self._periods.append(picture.stamp_ns - before_ns)
        elif picture.stamp_ns == before_ns:
            return None  # shown again
        self._waiting[eye].append(picture)
        left, right = self._waiting
        half_ns = 0.5 * float(np.median(self._periods)) if self._periods else np.inf
        while left and right:
            apart_ns = self._apart(left[0], right[0])
            if abs(apart_ns) <= half_ns:
                return self._paired(left.popleft(), right.popleft())
            (left if apart_ns > 0 else right).popleft()
            self.unpaired += 1
        return None

    def _apart(self, left: EyePicture, right: EyePicture) -> int:
        if self._common:
            return right.stamp_ns - left.stamp_ns
        return right.capture_ns - left.capture_ns

    def _paired(self, left: EyePicture, right: EyePicture) -> StereoPair | None:
        apart_ns = float(right.stamp_ns - left.stamp_ns)
        if not self._common:
            self._differences.append(right.stamp_ns - left.stamp_ns)
            apart_ns -= float(np.median(self._differences)) if len(self._differences) >= _KNOWN else apart_ns
        if abs(apart_ns) > self._apart_ns:
            self.unpaired += 2
            self._doubted.append(apart_ns)
            self._refuse(self._doubted)
            return None
        self._doubted.clear()
        self._number += 1
        return StereoPair(left.picture, right.picture, left.capture_ns, self._number)

    def _refuse(self, apart_ns: Sequence[float]) -> None:
        if len(apart_ns) < _DOUBTED:
            return
        span = f"{min(apart_ns) / 1e6:+.1f} to {max(apart_ns) / 1e6:+.1f} ms"
        why = (
            f"the right eye's pictures are {span} beside the left one's, {self._apart_ns / 1e6:g} ms at most:"
            " trigger both cameras by one line, or see genicam.trigger and apart_ms"
        )
        raise FrameRefused("measurement.camera.unpaired", why)
