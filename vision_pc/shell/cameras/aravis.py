"""GigE Vision and USB3 Vision through Aravis: the part of its C library that a camera source needs.

By ctypes and not by its bindings for Python: those are Debian's, for Debian's own Python alone. Install the
library with `apt-get install libaravis-0.8-0` (LGPL, loaded when a camera asks for it).
"""

import ctypes
import time
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from typing import Any, NamedTuple

from protocol.errors import ConfigurationError, LinkLost

_LIBRARY = "libaravis-0.8.so.0"
_POINTER, _TEXT, _INT, _DOUBLE = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_double
_BUFFERS = 8
_SUCCESS = 0  # ARV_BUFFER_STATUS_SUCCESS
_CONTINUOUS = 0  # ARV_ACQUISITION_MODE_CONTINUOUS


class _GError(ctypes.Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", _INT), ("message", _TEXT))


_ERROR = ctypes.POINTER(ctypes.POINTER(_GError))
# Name → result, arguments. Functions whose last argument is _ERROR are called without it: ``Aravis.ask``.
_FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "camera_new": (_POINTER, _TEXT, _ERROR),
    "camera_create_stream": (_POINTER, _POINTER, _POINTER, _POINTER, _ERROR),
    "camera_set_region": (None, _POINTER, _INT, _INT, _INT, _INT, _ERROR),
    "camera_set_pixel_format_from_string": (None, _POINTER, _TEXT, _ERROR),
    "camera_set_acquisition_mode": (None, _POINTER, _INT, _ERROR),
    "camera_set_frame_rate": (None, _POINTER, _DOUBLE, _ERROR),
    "camera_get_frame_rate": (_DOUBLE, _POINTER, _ERROR),
    "camera_set_exposure_time": (None, _POINTER, _DOUBLE, _ERROR),
    "camera_get_exposure_time": (_DOUBLE, _POINTER, _ERROR),
    "camera_set_gain": (None, _POINTER, _DOUBLE, _ERROR),
    "camera_get_gain": (_DOUBLE, _POINTER, _ERROR),
    "camera_set_trigger": (None, _POINTER, _TEXT, _ERROR),
    "camera_clear_triggers": (None, _POINTER, _ERROR),
    "camera_software_trigger": (None, _POINTER, _ERROR),
    "camera_is_feature_available": (_INT, _POINTER, _TEXT, _ERROR),
    "camera_set_boolean": (None, _POINTER, _TEXT, _INT, _ERROR),
    "camera_get_payload": (ctypes.c_uint, _POINTER, _ERROR),
    "camera_start_acquisition": (None, _POINTER, _ERROR),
    "camera_stop_acquisition": (None, _POINTER, _ERROR),
    "buffer_new_allocate": (_POINTER, ctypes.c_size_t),
    "buffer_get_status": (_INT, _POINTER),
    "buffer_get_data": (_POINTER, _POINTER, ctypes.POINTER(ctypes.c_size_t)),
    "buffer_get_timestamp": (ctypes.c_uint64, _POINTER),
    "buffer_get_system_timestamp": (ctypes.c_uint64, _POINTER),
    "buffer_get_frame_id": (ctypes.c_uint64, _POINTER),
    "buffer_get_image_width": (_INT, _POINTER),
    "buffer_get_image_height": (_INT, _POINTER),
    "buffer_get_image_pixel_format": (ctypes.c_uint32, _POINTER),
    "stream_push_buffer": (None, _POINTER, _POINTER),
    "stream_timeout_pop_buffer": (_POINTER, _POINTER, ctypes.c_uint64),
}


class Aravis:
    """The loaded library. Raises ConfigurationError (``extension.not_installed``) where it is absent."""

    def __init__(self) -> None:
        try:
            library, objects = ctypes.CDLL(_LIBRARY), ctypes.CDLL("libgobject-2.0.so.0")
        except OSError as error:
            why = "cameras of source genicam need Aravis: apt-get install libaravis-0.8-0"
            raise ConfigurationError("extension.not_installed", f"{why} ({error})") from error
        self._library, self._free = library, objects.g_object_unref
        self._free.restype, self._free.argtypes = None, [_POINTER]
        self.declare(_FUNCTIONS)

    def declare(self, functions: Mapping[str, tuple[Any, ...]]) -> None:
        """Say what functions return and take, in the form of ``_FUNCTIONS``."""
        for name, (result, *arguments) in functions.items():
            function = getattr(self._library, f"arv_{name}")
            function.restype, function.argtypes = result, arguments

    def call(self, name: str, *arguments: Any) -> Any:
        """What ``arv_name`` returns, of those that do not fail."""
        return getattr(self._library, f"arv_{name}")(*arguments)

    def ask(self, name: str, *arguments: Any) -> Any:
        """What ``arv_name`` returns. Raises LinkLost (``link.camera_refused``) with the library's words."""
        error = ctypes.POINTER(_GError)()
        result = getattr(self._library, f"arv_{name}")(*arguments, ctypes.byref(error))
        if error:
            why = error.contents.message.decode(errors="replace")
            raise LinkLost("link.camera_refused", f"{name.removeprefix('camera_')}: {why}")
        return result

    def release(self, thing: int | None) -> None:
        """Give up an object of the library."""
        if thing:
            self._free(thing)


@cache
def aravis() -> Aravis:
    """The library, loaded once. Raises ConfigurationError."""
    return Aravis()


class RawPicture(NamedTuple):
    """A picture as it came: bytes, size, PFNC code of its pixels; ``stamp_ns`` on the camera's clock,
    ``received_ns`` its first packet on this machine's monotonic clock, ``frame_id`` counted by the camera.
    """

    data: bytes
    width: int
    height: int
    pixel_format: int
    stamp_ns: int
    received_ns: int
    frame_id: int


class GenicamDevice:
    """One camera, by address or by Aravis' name (vendor, model, serial number). ``close`` gives it up."""

    def __init__(self, name: str) -> None:
        """Take control of it. Raises LinkLost (``link.camera_missing``), ConfigurationError."""
        self._arv, self.name = aravis(), name
        self._stream: int | None = None
        self._camera: int | None = None
        self.incomplete = 0
        try:
            self._camera = self._arv.ask("camera_new", name.encode())
        except LinkLost as error:
            raise LinkLost("link.camera_missing", f"camera {name}: {error}") from error

    def set(self, feature: str, *values: Any) -> None:
        """``arv_camera_set_…`` of this camera. Raises LinkLost (``link.camera_refused``)."""
        self._ask(feature, *(v.encode() if isinstance(v, str) else v for v in values))

    def get(self, feature: str) -> float:
        """``arv_camera_get_…``. Raises LinkLost (``link.camera_refused``)."""
        return float(self._ask(feature))

    def offers(self, feature: str) -> bool:
        """Whether the camera has the feature of this GenICam name."""
        return bool(self._ask("is_feature_available", feature.encode()))

    def start(self) -> None:
        """Begin to receive. Raises LinkLost."""
        self._stream = self._ask("create_stream", None, None)
        payload = self._ask("get_payload")
        for _ in range(_BUFFERS):
            self._arv.call("stream_push_buffer", self._stream, self._arv.call("buffer_new_allocate", payload))
        self._ask("set_acquisition_mode", _CONTINUOUS)
        self._ask("start_acquisition")

    def trigger(self) -> None:
        """Ask for one picture. Raises LinkLost."""
        self._ask("software_trigger")

    def next_picture(self, wait_s: float) -> RawPicture | None:
        """The next whole picture, or None; what came with gaps is counted in ``incomplete``."""
        call = self._arv.call
        buffer = call("stream_timeout_pop_buffer", self._stream, round(1e6 * wait_s))
        if not buffer:
            return None
        try:
            if call("buffer_get_status", buffer) != _SUCCESS:
                self.incomplete += 1
                return None
            size = ctypes.c_size_t()
            data = ctypes.string_at(call("buffer_get_data", buffer, ctypes.byref(size)), size.value)
            ago_ns = time.time_ns() - call("buffer_get_system_timestamp", buffer)
            return RawPicture(
                data,
                call("buffer_get_image_width", buffer),
                call("buffer_get_image_height", buffer),
                call("buffer_get_image_pixel_format", buffer),
                call("buffer_get_timestamp", buffer),
                time.monotonic_ns() - max(ago_ns, 0),
                call("buffer_get_frame_id", buffer),
            )
        finally:
            call("stream_push_buffer", self._stream, buffer)

    def close(self) -> None:
        """Stop, and let others control the camera."""
        if self._camera and self._stream:
            with suppress(LinkLost):  # it has gone
                self._ask("stop_acquisition")
        for thing in (self._stream, self._camera):
            self._arv.release(thing)
        self._stream = self._camera = None

    def _ask(self, name: str, *arguments: Any) -> Any:
        try:
            return self._arv.ask(f"camera_{name}", self._camera, *arguments)
        except LinkLost as error:
            raise LinkLost(error.cause, f"camera {self.name}: {error}") from error
