"""Two industrial cameras (GigE Vision, USB3 Vision), one an eye, through Aravis."""

import math
import time
from contextlib import ExitStack

from protocol.errors import ConfigurationError, FrameRefused, LinkLost
from vision_pc.config.camera import CameraSettings
from vision_pc.core.perception.pair_matching import EyePicture, PairMatcher
from vision_pc.core.perception.pixel_formats import grey_levels
from vision_pc.shell.cameras.aravis import GenicamDevice, RawPicture
from vision_pc.shell.cameras.source import CameraSource
from vision_pc.shell.cameras.stream import StreamClock

_RETRY_S = 1.0
_POLL_S = 0.005
_FRAME_NUMBERS = 0xFFFF  # of GVSP: 1 to 65535, then 1 again
_SAME_CLOCK_NS = -50_000_000, 10_000_000_000  # [D] from a stamp to its picture; another clock is years away
_READ_BACK = 0.02  # [D] a camera's own steps; beyond this part of what was set it is another setting


class GenicamCamera(CameraSource):
    """Connects to both, sets and reads back what is configured, and connects again when one has gone."""

    def _produce(self) -> None:
        settings = self._settings.genicam
        while not self._stop.is_set():
            try:
                with ExitStack() as stack:
                    devices = []
                    for name in (settings.left, settings.right):
                        devices.append(GenicamDevice(name))
                        stack.callback(devices[-1].close)
                    for device in devices:
                        self._prepare(device)
                    for device in devices:
                        device.start()
                    self._is_there()
                    self._receive(devices)
            except (FrameRefused, LinkLost, ConfigurationError) as error:
                self._is_gone(error.cause, str(error))
            self._stop.wait(_RETRY_S)

    def _prepare(self, device: GenicamDevice) -> None:
        """Raises LinkLost (``link.camera_refused``) for what the camera does not take as it is configured."""
        settings = self._settings.genicam
        size = self._settings.width_px, self._settings.height_px
        device.set("set_pixel_format_from_string", settings.pixel_format)
        device.set("set_region", settings.offset_x_px, settings.offset_y_px, *size)
        if settings.clock != "own" and device.offers("PtpEnable"):
            device.set("set_boolean", "PtpEnable", 1)
        if settings.trigger == "free":
            device.set("clear_triggers")
            self._set(device, "frame_rate", settings.frame_rate_hz)
        elif settings.trigger == "software":
            device.set("set_trigger", "Software")
        else:
            device.set("set_trigger", settings.trigger)
        self._set(device, "exposure_time", settings.exposure_us)
        self._set(device, "gain", settings.gain)

    def _set(self, device: GenicamDevice, feature: str, value: float | None) -> None:
        if value is None:
            return
        device.set(f"set_{feature}", value)
        got = device.get(f"get_{feature}")
        if not math.isclose(got, value, rel_tol=_READ_BACK, abs_tol=_READ_BACK):
            why = f"camera {device.name}: {feature} was set to {value:g} and is {got:g}: set what it can do"
            raise LinkLost("link.camera_refused", why)

    def _receive(self, devices: list[GenicamDevice]) -> None:
        """Deliver pairs until a camera fails or is silent. Raises LinkLost, FrameRefused."""
        settings = self._settings.genicam
        eyes = [_Eye(device, self._settings) for device in devices]
        pairs = PairMatcher(round(1e6 * settings.apart_ms), common_clock=settings.clock != "own")
        period_ns, due_ns, lost = 1e9 / settings.frame_rate_hz, time.monotonic_ns(), 0
        while not self._stop.is_set():
            now_ns = time.monotonic_ns()
            if settings.trigger == "software" and now_ns >= due_ns:
                for device in devices:
                    device.trigger()
                due_ns = max(due_ns + round(period_ns), now_ns)
            for which, eye in enumerate(eyes):
                picture = eye.next_picture(_POLL_S)
                pair = None if picture is None else pairs.add(which, picture)
                if pair is not None:
                    now_lost = pairs.unpaired // 2 + max(eye.lost for eye in eyes)
                    self._deliver(pair, max(now_lost - lost, 0))
                    lost = max(now_lost, lost)


class _Eye:
    """One camera's pictures on this machine's clock. ``lost``: pictures that never came, by its own count."""

    def __init__(self, device: GenicamDevice, settings: CameraSettings) -> None:
        self._device, self._size = device, (settings.width_px, settings.height_px)
        self._stale_ns = round(1e6 * settings.stale_ms)
        self._by_host = settings.genicam.clock == "host"
        self._latency_ns = round(1e6 * settings.genicam.latency_ms)
        self._clock = StreamClock()
        self._last: RawPicture | None = None
        self._heard_ns = time.monotonic_ns()
        self.lost = 0

    def next_picture(self, wait_s: float) -> EyePicture | None:
        """The next one, if it comes in time. Raises LinkLost for a camera silent too long, FrameRefused."""
        raw = self._device.next_picture(wait_s)
        now_ns = time.monotonic_ns()
        if raw is None:
            if now_ns - self._heard_ns > self._stale_ns:
                why = f"camera {self._device.name}: no whole picture came, {self._device.incomplete} had gaps"
                raise LinkLost("link.camera_silent", why)
            return None
        self._heard_ns = now_ns
        if (raw.width, raw.height) != self._size:
            why = f"camera {self._device.name}: pictures are {raw.width}×{raw.height} px, configured are"
            raise FrameRefused("frame.wrong_size", f"{why} {self._size[0]}×{self._size[1]}")
        if self._last is not None:
            if raw.stamp_ns < self._last.stamp_ns:
                self._clock = StreamClock()  # the camera began anew
            gap = (raw.frame_id - self._last.frame_id) % _FRAME_NUMBERS - 1
            self.lost += max(gap, 0) if raw.frame_id else 0
        self._last = raw
        picture = grey_levels(
            raw.data, raw.width, raw.height, raw.pixel_format, f"camera {self._device.name}"
        )
        return EyePicture(raw.stamp_ns, self._local_ns(raw), picture)

    def _local_ns(self, raw: RawPicture) -> int:
        """When it was taken, on this machine's monotonic clock. Raises FrameRefused for a foreign clock."""
        if not self._by_host:
            least_ns = self._clock.local_ns(raw.stamp_ns, raw.stamp_ns, raw.received_ns)
            return least_ns - self._latency_ns
        capture_ns = raw.stamp_ns + time.monotonic_ns() - time.time_ns()
        if not _SAME_CLOCK_NS[0] <= raw.received_ns - capture_ns <= _SAME_CLOCK_NS[1]:
            apart_s = (raw.received_ns - capture_ns) / 1e9
            why = f"camera {self._device.name}: a stamp is {apart_s:.3f} s before its picture came"
            raise FrameRefused("measurement.camera.clock", f"{why}: not by our clock; see genicam.clock")
        return capture_ns
