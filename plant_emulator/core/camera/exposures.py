"""What a camera that loses, repeats or cannot see frames makes of each capture."""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from plant_emulator.config.camera import CameraConfig
from plant_emulator.core.camera.camera_motion import Capture
from plant_emulator.core.camera.drift import Drift
from plant_emulator.core.faults.kinds import (
    AnyFault,
    BaseFault,
    CameraBlind,
    CameraFrozen,
    FramesDropped,
    MarkerCovered,
)

_DROP_STREAM, _FREEZE_STREAM, _STAMP_STREAM = 0x64726F70, 0x667265657A65, 0x7374616D70
_WORST_JITTER = 3.0  # standard deviations
FaultT = TypeVar("FaultT", bound=BaseFault)


class Shot(NamedTuple):
    """A frame as the camera sends it: its stamps, and what it shows.

    ``frame_id`` and ``capture_ns`` are the stamps, wrong by what the configuration says. ``shown`` is the
    capture whose picture it is, its time the true one; the same for every frame of a frozen camera, with what
    was ``blind`` and covered then. ``delivered``: false when lost.
    """

    frame_id: int
    capture_ns: int
    shown: Capture
    blind: CameraBlind | None
    covers: tuple[MarkerCovered, ...]
    delivered: bool


class Exposures:
    """Turns captures into shots, in their order; deterministic for a seed.

    Give it every capture instant, also those that nobody looks at: a frozen camera goes on showing the last
    one before it froze.
    """

    def __init__(self, config: CameraConfig, seed: int) -> None:
        self._config = config
        self._seed = seed
        self._last: Shot | None = None
        self._drift = Drift(config.drift, seed)

    def shot(self, capture: Capture, faults: Sequence[AnyFault]) -> Shot:
        """The frame that the camera sends at ``capture`` under the plant's ``faults`` in force."""
        dropping = _latest(faults, FramesDropped)
        lost = max(self._config.dropped_frame_share, dropping.share if dropping else 0.0)
        delivered = not self._drawn(_DROP_STREAM, capture.frame_id, lost)
        capture = capture._replace(drift_px=self._drift.at(capture.capture_ns))
        stamp_ns = self._stamp(capture)
        frozen = _latest(faults, CameraFrozen)
        if frozen is None and self._drawn(_FREEZE_STREAM, capture.frame_id, self._config.frozen_frame_share):
            frozen = CameraFrozen()
        if frozen is None or self._last is None:
            covers = tuple(fault for fault in faults if isinstance(fault, MarkerCovered))
            blind = _latest(faults, CameraBlind)
            self._last = Shot(capture.frame_id, stamp_ns, capture, blind, covers, delivered)
        elif frozen.stamps == "hold":
            self._last = self._last._replace(delivered=delivered)
        else:
            self._last = self._last._replace(
                frame_id=capture.frame_id, capture_ns=stamp_ns, delivered=delivered
            )
        return self._last

    def _stamp(self, capture: Capture) -> int:
        """The capture time that is told, never below the clock's zero."""
        stamps = self._config.stamps
        error_ms = stamps.delay_ms
        if stamps.jitter_ms > 0.0:
            draw = np.random.default_rng((self._seed, _STAMP_STREAM, capture.frame_id)).standard_normal()
            error_ms += stamps.jitter_ms * min(max(draw, -_WORST_JITTER), _WORST_JITTER)
        return max(capture.capture_ns + round(1e6 * error_ms), 0)

    def _drawn(self, stream: int, frame_id: int, share: float) -> bool:
        """Whether the lot falls on this frame."""
        return share > 0.0 and np.random.default_rng((self._seed, stream, frame_id)).random() < share


def _latest(faults: Sequence[AnyFault], kind: type[FaultT]) -> FaultT | None:
    return next((fault for fault in reversed(faults) if isinstance(fault, kind)), None)
