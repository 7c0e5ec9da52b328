"""From light to grey levels: exposure, response curve, vignetting, dirt on the lens, noise."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel
from plant_emulator.config.camera import AutoExposureConfig, CameraConfig
from plant_emulator.core.camera import rasteriser

Grey = NDArray[np.uint8]
Real32 = NDArray[np.float32]
Noise = NDArray[np.int16]

_NAMES = ("left", "right")
_WHITE = 255


class AutoExposure:
    """The servo that keeps pictures as bright as wanted; both eyes share it.

    Its gain depends on the pictures before: it is deterministic for the sequence of them.
    """

    def __init__(self, config: AutoExposureConfig) -> None:
        self._config = config
        self._time_ns: int | None = None
        self._gain = 1.0

    def gain(self, picture: Grey, brightness: float, capture_ns: int) -> float:
        """The gain of ``capture_ns``; the first picture that shows a new capture moves the servo.

        ``picture`` times ``brightness`` is the light that it meters.
        """
        config = self._config
        if not config.enabled or capture_ns == self._time_ns:
            return self._gain
        wanted = config.mean_grey / max(brightness * float(picture.mean()), 1.0)
        wanted = min(max(wanted, config.least_gain), config.most_gain)
        if self._time_ns is None or capture_ns < self._time_ns:
            self._gain = wanted  # it has been running since long before
        else:
            share = 1.0 - math.exp(-1e-9 * (capture_ns - self._time_ns) / config.time_constant_s)
            self._gain *= (wanted / self._gain) ** share
        self._time_ns = capture_ns
        return self._gain


class Imager:
    """What one eye's lens and sensor make of the light: ``centre`` (2,) px of its vignetting."""

    def __init__(self, config: CameraConfig, eye: int, centre: NDArray[np.float64], noise: Noise) -> None:
        self._noise = noise
        self._centre = (float(centre[0]), float(centre[1]))
        self._falloff = config.vignetting / ((config.width_px / 2.0) ** 2 + (config.height_px / 2.0) ** 2)
        self._noisy = config.noise_grey > 0.0
        levels = np.arange(_WHITE + 2) / _WHITE
        self._response = (_WHITE * np.minimum(levels, 1.0) ** config.response_gamma).astype(np.float32)
        self._straight = config.response_gamma == 1.0
        self._dirt = _dirt(config, _NAMES[eye])

    def expose(self, picture: Grey, key: int, gain: float) -> None:
        """Turn the light in ``picture`` into grey levels, in place; ``key`` chooses the noise."""
        if self._straight and self._dirt is None:
            self.sense(picture, key, gain, self._falloff)
            return
        height, width = picture.shape
        passed, added = self._dirt or (np.ones((1, 1), np.float32), np.zeros((1, 1), np.float32))
        passed, added = (np.broadcast_to(part, (height, width)) for part in (passed, added))
        line = _Line(np.empty(width, np.float32), np.empty(width, np.int32))
        _expose(picture, passed, added, gain, self._falloff, self._centre, self._response, line)
        self.sense(picture, key, 1.0, 0.0)

    def sense(self, picture: Grey, key: int, gain: float, falloff: float) -> None:
        """Apply gain, vignetting and noise to ``picture`` in place."""
        if self._noisy or falloff != 0.0 or gain != 1.0:
            rasteriser.finish(picture, self._noise, key, gain, falloff, *self._centre)


def _dirt(config: CameraConfig, eye: str) -> tuple[Real32, Real32] | None:
    """The shares of light (height, width) that the dirt on this eye lets pass, and the grey that it adds."""
    spots = [spot for spot in config.dirt if spot.eye == eye]
    if not spots:
        return None
    v, u = np.mgrid[0 : config.height_px, 0 : config.width_px]
    passed, added = np.ones(v.shape), np.zeros(v.shape)
    for spot in spots:
        far = ((u - spot.centre_px[0]) ** 2 + (v - spot.centre_px[1]) ** 2) / spot.radius_px**2
        cover = np.exp(-0.5 * far)
        passed *= 1.0 - (1.0 - spot.transmission) * cover
        added += spot.scatter_grey * cover
    return passed.astype(np.float32), added.astype(np.float32)


class _Line(NamedTuple):
    """Room for one row: the light on the sensor, and the whole part of it."""

    light: Real32
    level: NDArray[np.int32]


@kernel(nogil=True)
def _expose(
    picture: Grey,
    passed: Real32,
    added: Real32,
    gain: float,
    falloff: float,
    centre: tuple[float, float],
    response: Real32,
    line: _Line,
) -> None:
    """Dirt, vignetting, gain, saturation and response curve, in place.

    In two loops a row, because compilers vectorise the first and leave only the look-up scalar.
    """
    black, white, half = np.float32(0.0), np.float32(_WHITE), np.float32(0.5)
    light, level = line
    for i in range(picture.shape[0]):
        row, passes, adds, vertical = picture[i], passed[i], added[i], (i - centre[1]) ** 2
        for j in range(row.shape[0]):
            r2 = (j - centre[0]) ** 2 + vertical
            falls = (row[j] * passes[j] + adds[j]) * np.float32(gain * (1.0 - falloff * r2))
            light[j] = min(max(falls, black), white)
            level[j] = np.int32(light[j])
        for j in range(row.shape[0]):
            k = np.intp(level[j])
            part = light[j] - np.float32(k)
            row[j] = np.uint8(np.int32(response[k] + (response[k + 1] - response[k]) * part + half))
