"""A stereo camera that shows both eyes side by side in one UVC picture, such as a ZED2 at 2560×720."""

import time
from pathlib import Path

import cv2
import numpy as np

from protocol.errors import FrameRefused, LinkLost
from vision_pc.core.types import Image, StereoPair
from vision_pc.shell.cameras.source import CameraSource

_RETRY_S = 1.0
_MANUAL_EXPOSURE = 1.0  # V4L2's V4L2_EXPOSURE_MANUAL
_EXPOSURE_UNIT_US = 100.0  # of V4L2's exposure_time_absolute


def grey(picture: Image) -> Image:
    """``picture`` as grey levels (height, width) uint8: of grey, BGR, BGRA or YUYV, of 8 or 16 bits.

    Raises FrameRefused (``frame.wrong_pixels``) for anything else.
    """
    if picture.dtype == np.uint16:
        picture = (picture >> 8).astype(np.uint8)
    codes = {1: None, 2: cv2.COLOR_YUV2GRAY_YUYV, 3: cv2.COLOR_BGR2GRAY, 4: cv2.COLOR_BGRA2GRAY}
    channels = 1 if picture.ndim == 2 else picture.shape[2]
    if picture.dtype != np.uint8 or channels not in codes:
        raise FrameRefused(
            "frame.wrong_pixels",
            f"pictures of {channels} channels of {picture.dtype} came; grey, BGR, BGRA or YUYV are wanted",
        )
    code = codes[channels]
    if code is None:
        return np.asarray(picture.reshape(picture.shape[:2]), dtype=np.uint8)
    return np.asarray(cv2.cvtColor(picture, code), dtype=np.uint8)


def halves(picture: Image, source: str) -> tuple[Image, Image]:
    """The left and the right eye of a side-by-side ``picture``, grey. Raises FrameRefused."""
    both = grey(picture)
    if both.shape[1] % 2:
        why = f"{source}: a picture {both.shape[1]} px wide came, both eyes side by side have an even width"
        raise FrameRefused("frame.wrong_size", why)
    left, right = np.ascontiguousarray(np.stack(np.hsplit(both, 2)))
    return left, right


def _begins_anew(film: cv2.VideoCapture) -> bool:
    """Whether ``film`` gives its first picture again."""
    return bool(film.set(cv2.CAP_PROP_POS_FRAMES, 0)) and film.grab()


class UvcCamera(CameraSource):
    """Grabs side-by-side pictures and cuts them in two. ``device`` may also be the path of a film, which is
    played at its own rate, over and over.
    """

    def _produce(self) -> None:
        device = self._settings.uvc.device
        while not self._stop.is_set():
            film = cv2.VideoCapture(device)
            try:
                if film.isOpened():
                    self._is_there()
                    self._grab(film)
                else:
                    self._is_gone("link.camera_missing", f"{device}: no such device or film, or it is in use")
            except (FrameRefused, LinkLost) as error:
                self._is_gone(error.cause, str(error))
            finally:
                film.release()
            self._stop.wait(_RETRY_S)

    def _prepare(self, film: cv2.VideoCapture) -> None:
        settings = self._settings
        film.set(cv2.CAP_PROP_FRAME_WIDTH, 2 * settings.width_px)
        film.set(cv2.CAP_PROP_FRAME_HEIGHT, settings.height_px)
        film.set(cv2.CAP_PROP_FPS, settings.uvc.frame_rate_hz)
        film.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if settings.uvc.exposure_us is not None:
            film.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
            film.set(cv2.CAP_PROP_EXPOSURE, settings.uvc.exposure_us / _EXPOSURE_UNIT_US)
        if settings.uvc.gain is not None:
            film.set(cv2.CAP_PROP_GAIN, settings.uvc.gain)

    def _grab(self, film: cv2.VideoCapture) -> None:
        """Deliver pairs until the device fails. Raises LinkLost or FrameRefused with the cause."""
        self._prepare(film)
        source = str(self._settings.uvc.device)
        latency_ns = int(self._settings.uvc.latency_ms * 1e6)
        between_s = 1.0 / max(film.get(cv2.CAP_PROP_FPS), 1.0) if Path(source).is_file() else 0.0
        frame_id, due_s = 0, time.monotonic()
        while not self._stop.is_set():
            self._stop.wait(due_s - time.monotonic())
            due_s += between_s
            if not film.grab() and not (between_s and frame_id and _begins_anew(film)):
                raise LinkLost("link.camera_missing", f"{source}: no more pictures")
            capture_ns = time.monotonic_ns() - latency_ns
            taken, picture = film.retrieve()
            if not taken:
                raise LinkLost("link.camera_missing", f"{source}: a picture could not be decoded")
            left, right = halves(np.asarray(picture), source)
            self._check_size(left, source)
            frame_id += 1
            self._deliver(StereoPair(left, right, capture_ns, frame_id))
