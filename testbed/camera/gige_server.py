"""The emulated stereo camera as two GigE Vision cameras: both show the newest pair, with its capture time."""

import threading
import time
from contextlib import ExitStack, suppress
from functools import partial

import numpy as np

from testbed.camera.fake_gige import FakeGigeCamera
from testbed.reporting.console import err, out
from vision_pc.config.camera import CameraSettings
from vision_pc.core.types import Image, StereoPair
from vision_pc.shell.cameras.stream import StreamCamera

_WAIT_S = 0.2  # for the next pair; a camera that waits longer is deaf to who controls it


class _ShownStream(StreamCamera):
    """A frame stream whose newest pair the cameras' own threads ask for."""

    def __init__(self, settings: CameraSettings) -> None:
        super().__init__(settings)
        self._news = threading.Condition()
        self._newest: StereoPair | None = None
        self._seen = [0, 0]
        self._announced = ""

    def _deliver(self, pair: StereoPair, dropped: int = 0) -> None:
        self._announced = ""
        with self._news:
            self._newest = pair
            self._news.notify_all()

    def _is_gone(self, cause: str, detail: str = "") -> None:
        if cause != self._announced:
            err.print(f"{cause}: no pictures from the stream {detail}", highlight=False, soft_wrap=True)
        self._announced = cause

    def shown(self, eye: int, width: int, height: int) -> tuple[bytes, int]:
        """Pixels of ``eye``'s next picture, and its capture time in ns since 1970; the last one again where
        none comes in time.
        """
        with self._news:
            self._news.wait_for(lambda: self._newest and self._newest.frame_id != self._seen[eye], _WAIT_S)
            pair = self._newest
        if pair is None:
            return bytes(width * height), time.time_ns()
        self._seen[eye] = pair.frame_id
        since_1970_ns = time.time_ns() - time.monotonic_ns()
        return _fitted((pair.left, pair.right)[eye], width, height).tobytes(), pair.capture_ns + since_1970_ns

    def begin(self) -> None:
        """Begin to receive."""
        self._thread.start()

    def end(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join()


def _fitted(picture: Image, width: int, height: int) -> Image:
    """The upper left region of ``picture``, black where it has nothing."""
    region = np.zeros((height, width), dtype=np.uint8)
    part = picture[:height, :width]
    region[: part.shape[0], : part.shape[1]] = part
    return region


def serve_gige(settings: CameraSettings, left: str, right: str) -> None:
    """Show the stream that ``settings`` name at two addresses, until Ctrl-C. Raises LinkLost."""
    with ExitStack() as stack:
        stream = _ShownStream(settings)
        for eye, address in enumerate((left, right)):
            camera = FakeGigeCamera(address, f"LR{eye + 1:02d}", partial(stream.shown, eye))
            stack.callback(camera.close)
        stream.begin()
        stack.callback(stream.end)
        out.print(f"two GigE Vision cameras: left {left}, right {right}; Ctrl-C ends", highlight=False)
        with suppress(KeyboardInterrupt):
            threading.Event().wait()
