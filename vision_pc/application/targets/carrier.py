"""What goes along with every look and watch of the eyes, so that clicked targets stay known."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from vision_pc.application.reference_link import ReferenceLink
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry.foreign_poses import PoseFeed
from vision_pc.core.perception.watch import Odometry
from vision_pc.core.pixel_sensor import PixelSensor
from vision_pc.core.se3 import Array
from vision_pc.core.targets.keeper import TargetKeeper
from vision_pc.core.targets.known_target import again
from vision_pc.core.targets.sighting import KnownTarget, Sighted
from vision_pc.core.targets.target import TargetRefused
from vision_pc.core.types import CameraErrors, FrameObservation, Look, StereoPair, WatchSample

_NOISE = 1e-8  # m², rad²
_OWN = 0.1  # share of a carried pose's covariance that may differ from frames that do show the target


class AimedSensor:
    """Implements ``vision_pc.core.perception.watch.Sensor``: programs get the target as their object.

    ``resting``: the arm stands where the target's place is known; what cannot be seen there is where it was
    carried. Otherwise what is not seen is missing. ``measured`` counts the frames that showed it.
    """

    def __init__(self, config: VisionConfig, targets: TargetKeeper, feed: PoseFeed | None = None) -> None:
        self._pixels = PixelSensor(config, feed)
        self._config = config
        self._targets = targets
        self.camera = self._pixels.camera
        self.resting = False
        self.measured = 0
        self.why = ""

    def observe(self, frame: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """Tool and object of interest in this pair; the object is the target that is aimed at."""
        kept = self._targets.aimed
        if kept is None:
            return self._pixels.observe(frame, previous)
        before = None if previous is None else previous._replace(X_CO=None)
        seen = self._pixels.observe(frame, before)
        X = kept.X_CO if self.resting or previous is None or previous.X_CO is None else previous.X_CO
        known = kept.believed._replace(X_CO=X)
        try:
            found = again(self.sighted(frame, seen), known)
        except TargetRefused as refused:
            self.why = refused.cause
            return self._observation_carried(seen, known) if self.resting else _with(seen, None, None, None)
        self.measured += 1
        return _with(seen, found.X_CO, found.covariance, found.bias)

    def sighted(self, pair: StereoPair, observation: FrameObservation) -> Sighted:
        """The pair for who measures targets in it."""
        return Sighted(pair, self.camera, observation, self._config.markers, self._config.targets)

    def odometry(self, previous: FrameObservation | None) -> Odometry[StereoPair]:
        """As ``PixelSensor``."""
        return self._pixels.odometry(previous)

    def errors(self, samples: Sequence[WatchSample]) -> CameraErrors | None:
        """As ``PixelSensor``."""
        return self._pixels.errors(samples)

    def plain(self, frame: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """Tool and object's markers, whatever is aimed at."""
        return self._pixels.observe(frame, previous)

    def _observation_carried(self, seen: FrameObservation, known: KnownTarget) -> FrameObservation:
        noise = _OWN * known.covariance + _NOISE * np.eye(6)
        return _with(seen, known.X_CO, known.covariance + noise, known.covariance)


def _with(
    seen: FrameObservation, X: Array | None, covariance: Array | None, bias: Array | None
) -> FrameObservation:
    missing = "not_seen" if X is None else None
    return seen._replace(X_CO=X, cov_CO=covariance, bias_CO=bias, missing_object=missing)


class TargetCarrier:
    """Goes along with every look and watch, so that the targets of ``targets`` stay known."""

    def __init__(self, targets: TargetKeeper, sensor: AimedSensor, states: ReferenceLink) -> None:
        self._targets = targets
        self._sensor = sensor
        self._states = states
        self._watching = False

    @property
    def carries(self) -> bool:
        """Whether a motion must be watched, because targets are kept and nobody watches."""
        return bool(self._targets.list()) and not self._watching

    @property
    def object_wanted(self) -> bool:
        """Whether a watch that never sees the object's markers has failed: not for a target."""
        return self._targets.aimed is None

    @property
    def X_BT(self) -> Array:
        """Where the controller has the tool now. Raises LinkLost."""
        return se3.from_pose(self._states.state.X_BT)

    @contextmanager
    def looking(self) -> Iterator[Callable[[Look], None]]:
        """A look: a target that is aimed at is measured, or stands where it was carried.

        Raises RequestRefused (``refused.target_lost``) where nobody knows that.
        """
        if self._targets.aimed is None:
            yield forgotten
            return
        self._targets.refuse_lost(self.X_BT)
        self._sensor.resting, self._sensor.measured = True, 0
        try:
            yield self._looked
        finally:
            self._sensor.resting = False

    @contextmanager
    def watching(self) -> Iterator[Callable[[tuple[WatchSample, ...]], None]]:
        """A watch: targets are carried by its last odometry; a watch that fails loses them."""
        if not self._targets.list():
            yield forgotten
            return
        X_BT, ends = self.X_BT, list[Array | None]()
        self._watching = True
        try:
            yield lambda samples: ends.append(samples[-1].X_C0C)
        finally:
            self._watching = False
            self._targets.carry(ends[0] if ends else None, X_BT, self.X_BT)

    def _looked(self, look: Look) -> None:
        measured = 2 * self._sensor.measured > look.frames
        self._targets.looked(look.X_CO, look.cov_CO, look.X_BT, measured)


def forgotten(_seen: Look | tuple[WatchSample, ...]) -> None:
    """Nobody wants to know."""
