"""What every camera of the service shares: a thread that produces pairs, and a feed on the event loop."""

import asyncio
import threading
from abc import abstractmethod
from collections.abc import AsyncIterator, Callable
from typing import Any

from vision_pc.application.camera_feed import CameraFeed
from vision_pc.config.camera import CameraSettings
from vision_pc.config.stereo_camera import StereoCalibration
from vision_pc.core.perception.rectification import Rectifier, refuse_size
from vision_pc.core.pixel_sensor import FrozenPictures
from vision_pc.core.types import Image, StereoPair
from vision_pc.shell.camera_eyes import ProcessClock

_JOIN_S = 1.0


class CameraSource(CameraFeed[StereoPair]):
    """Pairs from a camera, rectified where ``calibration`` is a raw camera's.

    The thread in ``_produce`` blocks; everything else belongs to the event loop. ``there``: it was once.
    """

    def __init__(self, settings: CameraSettings) -> None:
        """Compute the maps of a raw camera. Raises ConfigurationError for a lens that folds over."""
        super().__init__(settings, ProcessClock())
        known = settings.calibration
        self._rectified = Rectifier(known) if isinstance(known, StereoCalibration) else None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._produce, name=f"camera-{settings.source}", daemon=True)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._pictures = FrozenPictures(settings.frozen_frames)
        self.there = asyncio.Event()

    async def start(self) -> None:
        """Begin to connect; pairs come as soon as the camera is there."""
        self._loop = asyncio.get_running_loop()
        self._started_ns = self._clock.now_ns
        self._thread.start()

    async def close(self) -> None:
        """End the thread."""
        self._stop.set()
        if self._thread.is_alive():
            await asyncio.to_thread(self._thread.join, _JOIN_S)

    async def pairs(self) -> AsyncIterator[StereoPair]:
        """Newest pairs from now on; what comes while the caller is busy is skipped. Raises as
        ``frame_after``.
        """
        capture_ns = self._clock.now_ns
        while True:
            pair = await self.frame_after(capture_ns)
            capture_ns = pair.capture_ns
            yield pair

    @abstractmethod
    def _produce(self) -> None:
        """Runs in the thread until ``_stop`` is set, calling ``_deliver``, ``_is_there`` and ``_is_gone``."""

    def _is_there(self) -> None:
        """From the thread: a connection stands."""
        self._call(self.connected)
        self._call(self.there.set)

    def _is_gone(self, cause: str, detail: str = "") -> None:
        """From the thread: the connection ended or could not be made."""
        self._call(self.lost, cause, detail)

    def _check_size(self, picture: Image, source: str) -> None:
        """Raises FrameRefused (``frame.wrong_size``) where one eye's picture is not as configured."""
        refuse_size(picture, (self._settings.width_px, self._settings.height_px), source)

    def _deliver(self, pair: StereoPair, dropped: int = 0) -> None:
        """From the thread: a pair of the configured size, before which ``dropped`` never came."""
        self._call(self._arrived, self._rectified(pair) if self._rectified else pair, dropped)

    def _arrived(self, pair: StereoPair, dropped: int) -> None:
        self.publish(pair, dropped, frozen=self._pictures.add(pair.left))

    def _call(self, function: Callable[..., None], *arguments: Any) -> None:
        if self._loop is None or self._stop.is_set():
            return
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:  # the loop was closed while the thread was on its way
            self._stop.set()
