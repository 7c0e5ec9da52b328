"""GigE Vision cameras of Aravis' own on addresses of this machine: what an emulated pair is shown by."""

import ctypes
from collections.abc import Callable
from typing import Any

from vision_pc.shell.cameras.aravis import aravis

_FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "gv_fake_camera_new": (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_char_p),
    "gv_fake_camera_is_running": (ctypes.c_int, ctypes.c_void_p),
    "gv_fake_camera_get_fake_camera": (ctypes.c_void_p, ctypes.c_void_p),
    "fake_camera_set_fill_pattern": (None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p),
    "buffer_set_timestamp": (None, ctypes.c_void_p, ctypes.c_uint64),
}


Fill = Callable[[int, int], tuple[bytes, int]]
"""Width and height → the pixels (grey, 8 bits) and their capture time on the camera's clock (ns)."""
_FILL = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32
)


class FakeGigeCamera:
    """A GigE Vision camera of Aravis' own on an address of this machine; ``fill`` gives its pictures."""

    def __init__(self, address: str, serial: str, fill: Fill) -> None:
        self._arv = aravis()
        self._arv.declare(_FUNCTIONS)
        self._camera = self._arv.call("gv_fake_camera_new", address.encode(), serial.encode())
        if not self._camera or not self._arv.call("gv_fake_camera_is_running", self._camera):
            raise OSError(f"{address}: no address of a network interface here")

        def filled(buffer: int, _user: int, _exposure: int, _gain: int, _pixel_format: int) -> None:
            width, height = (self._arv.call(f"buffer_get_image_{w}", buffer) for w in ("width", "height"))
            pixels, stamp_ns = fill(width, height)
            size = ctypes.c_size_t()
            ctypes.memmove(self._arv.call("buffer_get_data", buffer, ctypes.byref(size)), pixels, len(pixels))
            self._arv.call("buffer_set_timestamp", buffer, stamp_ns)

        self._filled = _FILL(filled)  # the library holds its address alone
        inner = self._arv.call("gv_fake_camera_get_fake_camera", self._camera)
        self._arv.call(
            "fake_camera_set_fill_pattern", inner, ctypes.cast(self._filled, ctypes.c_void_p), None
        )

    def close(self) -> None:
        """End it."""
        self._arv.release(self._camera)
        self._camera = None
