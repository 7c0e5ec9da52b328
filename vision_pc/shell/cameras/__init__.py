"""Stereo cameras behind one interface: the emulated stream, a side-by-side UVC device, industrial ones."""

from collections.abc import Callable

from vision_pc.config.camera import CameraSettings
from vision_pc.shell.cameras.genicam import GenicamCamera
from vision_pc.shell.cameras.source import CameraSource
from vision_pc.shell.cameras.stream import StreamCamera
from vision_pc.shell.cameras.uvc import UvcCamera

__all__ = ["CameraSource", "open_camera"]


def open_camera(settings: CameraSettings) -> CameraSource:
    """The camera that the configuration names; nothing is opened before its ``start``."""
    kinds: dict[str, Callable[[CameraSettings], CameraSource]] = {
        "stream": StreamCamera,
        "uvc": UvcCamera,
        "genicam": GenicamCamera,
    }
    return kinds[settings.source](settings)
