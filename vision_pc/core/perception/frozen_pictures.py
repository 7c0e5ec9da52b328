"""Whether pictures are live: a camera that hands out one picture again and again has frozen."""

from vision_pc.core.types import Image

_STEP = 32  # px: a picture is compared by every such pixel of every such row


class FrozenPictures:
    """Counts how often a picture repeated the one before to the last grey level, which noise forbids in live
    ones. ``limit``: so many repetitions, and the camera counts as frozen; 0: never.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._fingerprint = b""
        self._count = 0

    def add(self, image: Image) -> bool:
        """Take the newest picture. Return True if the camera is frozen."""
        fingerprint = image[::_STEP, ::_STEP].tobytes()
        self._count = self._count + 1 if fingerprint == self._fingerprint else 0
        self._fingerprint = fingerprint
        return 0 < self._limit <= self._count
