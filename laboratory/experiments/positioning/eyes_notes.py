"""A sight with rendered pictures that notes, beside everything vision measures, what was true."""

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from plant_emulator.core.camera.exposures import Capture
from plant_emulator.core.camera.scene import Scene
from testbed.lockstep.camera_side import Exposure
from testbed.lockstep.simulated_measurements import PixelFrames, Sight
from testbed.lockstep.true_view import TrueView
from testbed.lockstep.world import World
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception.intrinsics import as_believed
from vision_pc.core.pixel_sensor import PixelSensor
from vision_pc.core.se3 import Array
from vision_pc.core.types import (
    CameraCalibration,
    CameraErrors,
    FrameObservation,
    OdometryPose,
    StereoPair,
    WatchSample,
)

_SAME_PLACE_PX = 0.3  # a corner that moved by less is at the same place in the picture


class Tracked(NamedTuple):
    """One frame of a watch: what it shows, the tool marker that odometry was told of, what it made of it."""

    shown: Capture
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


def noting_sight(world: World, notes: Notes) -> Sight:
    """Vision's own sight of rendered pictures on ``world``, its measurements noted."""
    sensor = NotingSensor(world, notes)
    world.camera.viewers.append(sensor.exposed)
    return Sight(PixelFrames(world), sensor)


class NotingSensor:
    """Implements ``vision_pc.core.perception.watch.Sensor`` as ``PixelSensor`` does, and notes."""

    def __init__(self, world: World, notes: Notes) -> None:
        self.shown: dict[int, Capture] = {}
        self._pixels = PixelSensor(world.settings.vision)
        self._view = TrueView(world.settings.scene.camera, Scene(world.settings.scene))
        self._notes = notes
        self._places: dict[tuple[int, int, int], tuple[int, Array]] = {}

    def exposed(self, exposure: Exposure) -> None:
        """Keep what ``exposure`` shows."""
        self.shown[exposure.shot.frame_id] = exposure.shot.shown

    def observe(self, frame: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """What the pictures show, noted beside the truth."""
        observation = self._pixels.observe(frame, previous)
        found = {m.marker_id: m for m in observation.markers}
        for number, exact in self._view.markers(self.shown[frame.frame_id]).items():
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

    def odometry(self, previous: FrameObservation | None) -> "NotingOdometry":
        """Vision's odometry, noted as a new watch."""
        followed = Followed(as_believed(self._pixels.camera, previous), [])
        self._notes.watches.append(followed)
        return NotingOdometry(self._pixels.own_odometry(previous), self.shown, followed)

    def errors(self, samples: Sequence[WatchSample]) -> CameraErrors | None:
        """What vision makes of a watch."""
        return self._pixels.errors(samples)

    def _note(self, number: int, eye: int, seen: Array, true: Array) -> None:
        for corner in range(4):
            key = (number, eye, corner)
            visit, at = self._places.get(key, (-1, np.full(2, np.inf)))
            if np.linalg.norm(true[corner] - at) > _SAME_PLACE_PX:
                visit, at = visit + 1, true[corner]
                self._places[key] = visit, at
            self._notes.corners[(*key, visit)].append(seen[corner] - true[corner])


class NotingOdometry:
    """Vision's odometry beside the truth."""

    def __init__(self, odometry: StereoOdometry, shown: dict[int, Capture], followed: Followed) -> None:
        self._odometry = odometry
        self._shown = shown
        self._followed = followed

    @property
    def last_loss(self) -> str | None:
        """Why the last frame was lost."""
        return self._odometry.last_loss

    def process(
        self, frame: StereoPair, X_CM: Array | None = None, X_BT: Array | None = None
    ) -> OdometryPose | None:
        """The pose, noted."""
        pose = self._odometry.process(frame, X_CM, X_BT)
        self._followed.frames.append(Tracked(self._shown[frame.frame_id], X_CM, pose))
        return pose
