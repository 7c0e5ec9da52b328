"""A stereo camera that shows both eyes side by side in one UVC picture, such as a ZED2 at 2560×720."""

import time

import cv2
import numpy as np

from vision_pc.core.types import StereoPair
from vision_pc.shell.cameras.source import CameraSource

_RETRY_S = 1.0


class UvcCamera(CameraSource):
    """Grabs side-by-side pictures and cuts them in two. ``device`` may also be the path of a film."""

    def _produce(self) -> None:
        while not self._stop.is_set():
            device = self._settings.uvc.device
            film = cv2.VideoCapture(device)
            try:
                if film.isOpened():
                    self._is_there()
                    self._is_gone(self._grab(film))
                else:
                    self._is_gone("link.camera_missing")
            finally:
                film.release()
            self._stop.wait(_RETRY_S)

    def _grab(self, film: cv2.VideoCapture) -> str:
        """Deliver pairs until the device fails; the cause."""
        settings = self._settings
        film.set(cv2.CAP_PROP_FRAME_WIDTH, 2 * settings.width_px)
        film.set(cv2.CAP_PROP_FRAME_HEIGHT, settings.height_px)
        film.set(cv2.CAP_PROP_FPS, settings.uvc.frame_rate_hz)
        film.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        latency_ns = int(settings.uvc.latency_ms * 1e6)
        frame_id = 0
        while not self._stop.is_set():
            if not film.grab():
                return "link.camera_missing"
            capture_ns = time.monotonic_ns() - latency_ns
            taken, picture = film.retrieve()
            if not taken:
                return "link.camera_missing"
            grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture
            if grey.shape != (settings.height_px, 2 * settings.width_px):
                return "frame.wrong_size"
            frame_id += 1
            left, right = np.ascontiguousarray(np.stack(np.hsplit(grey, 2)))
            self._deliver(StereoPair(left, right, capture_ns, frame_id))
        return "link.camera_closed"
