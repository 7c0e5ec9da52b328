"""A sight with rendered pictures that notes, beside everything vision measures, what was true."""

from collections import defaultdict
from typing import NamedTuple

import numpy as np

from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.truth import PlantTruth
from testbed.lockstep.sight import Deliver, PixelSight
from testbed.lockstep.true_view import TrueView
from testbed.lockstep.world import World
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception.watch import Odometry, Watcher
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, FrameObservation, OdometryPose, StereoPair

_SAME_PLACE_PX = 0.3  # a corner that moved by less is at the same place in the picture


class Tracked(NamedTuple):
    """One frame of a watch: the truth, the tool marker that odometry was told of, and what it made of it."""

    truth: PlantTruth
    X_CM: Array | None
    pose: OdometryPose | None


class Followed(NamedTuple):
    """One watch: the camera as vision believed it to be, and its frames."""

    camera: CameraCalibration
    frames: list[Tracked]


class Notes:
    """What one run showed.

    ``corners``: errors (2,) px of one corner in one eye at one place in the picture, a list for each;
    ``expected`` markers were whole in view, ``missed`` of them not sighted; ``watches`` with odometry.
    """

    def __init__(self) -> None:
        self.corners: dict[tuple[int, ...], list[Array]] = defaultdict(list)
        self.expected = 0
        self.missed = 0
        self.watches: list[Followed] = []


class NotingSight:
    """Implements ``testbed.lockstep.sight.Sight`` as ``PixelSight`` does, and notes."""

    def __init__(self, world: World, config: VisionConfig, notes: Notes) -> None:
        self._world = world
        self._pixels = PixelSight(world, config)
        self._config = config
        self._view = TrueView(world.settings.scene.camera, Scene(world.settings.scene))
        self._notes = notes
        self._places: dict[tuple[int, int, int], tuple[int, Array]] = {}
        self.truths: dict[int, PlantTruth] = {}

    def begin(self, deliver: Deliver) -> None:
        """Start to render pictures and to keep their true values."""
        self.truths.clear()
        self._world.on_exposure = self.truths.__setitem__
        self._pixels.begin(deliver)

    def end(self) -> None:
        """Stop rendering pictures."""
        self._pixels.end()
        self._world.on_exposure = None

    def observe(self, pair: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """What the pictures show, noted beside the truth."""
        observation = self._pixels.observe(pair, previous)
        truth = self.truths[pair.frame_id]
        found = {m.marker_id: m for m in observation.markers}
        for number, exact in self._view.markers(truth.X_WC, truth.X_WM).items():
            if exact.left is None:
                continue
            self._notes.expected += 1
            if number not in found:
                self._notes.missed += 1
                continue
            marker = found[number]
            for eye, (seen, true) in enumerate(
                ((marker.corners_left, exact.left), (marker.corners_right, exact.right))
            ):
                if seen is not None and true is not None:
                    self._note(number, eye, seen, true)
        return observation

    def watcher(self, *, markers: bool, odometry: bool, previous: FrameObservation | None) -> Watcher:
        """Vision's own watcher, its measurements noted."""
        return _NotingWatcher(self, self._config, markers, odometry, previous)

    def followed(self, camera: CameraCalibration) -> Followed:
        """Where the frames of a new watch are to be noted."""
        self._notes.watches.append(Followed(camera, []))
        return self._notes.watches[-1]

    @property
    def camera(self) -> CameraCalibration:
        """Vision's calibration."""
        return self._pixels.camera

    def _note(self, number: int, eye: int, seen: Array, true: Array) -> None:
        for corner in range(4):
            key = (number, eye, corner)
            visit, at = self._places.get(key, (-1, np.full(2, np.inf)))
            if np.linalg.norm(true[corner] - at) > _SAME_PLACE_PX:
                visit, at = visit + 1, true[corner]
                self._places[key] = visit, at
            self._notes.corners[(*key, visit)].append(seen[corner] - true[corner])


class _NotingWatcher(Watcher):
    """Vision's watcher, whose measurements are noted."""

    def __init__(
        self,
        sight: NotingSight,
        config: VisionConfig,
        markers: bool,
        odometry: bool,
        previous: FrameObservation | None,
    ) -> None:
        super().__init__(sight.camera, config, markers=markers, odometry=odometry, previous=previous)
        self._sight = sight

    def observe(self, pair: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """What the pictures show, noted."""
        return self._sight.observe(pair, previous)

    def new_odometry(self, camera: CameraCalibration) -> Odometry:
        """Vision's odometry, noted."""
        return _NotingOdometry(super().new_odometry(camera), self._sight, camera)


class _NotingOdometry:
    """Vision's odometry beside the truth."""

    def __init__(self, odometry: Odometry, sight: NotingSight, camera: CameraCalibration) -> None:
        self._odometry = odometry
        self._sight = sight
        self._followed = sight.followed(camera)

    @property
    def last_loss(self) -> str | None:
        """Why the last frame was lost."""
        return self._odometry.last_loss

    def process(self, pair: StereoPair, X_CM: Array | None = None) -> OdometryPose | None:
        """The pose, noted."""
        pose = self._odometry.process(pair, X_CM)
        self._followed.frames.append(Tracked(self._sight.truths[pair.frame_id], X_CM, pose))
        return pose
