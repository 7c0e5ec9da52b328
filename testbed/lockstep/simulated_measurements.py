"""Eyes without pictures, for long campaigns: the true camera's geometry with the errors that pictures make.

What is drawn at random is only what pictures add: noise and bias of marker corners, noise of tracked points,
depths of the map's points, failures. All of it was measured from rendered pictures:
``configs/eye_model.yaml``. Everything else is exact or vision's own: true lenses,
rectification, prints and what hides what on one side; poses, covariances, offset and looks on the other.
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import Field

from foundation.configuration import StrictModel, load
from plant_emulator.core.camera.exposures import Shot
from plant_emulator.core.camera.scene import Scene
from protocol.errors import ConfigurationError
from testbed.lockstep.camera_side import Exposure
from testbed.lockstep.simulated_odometry import ModelOdometry, SimulatedFrame, TrackingNoise
from testbed.lockstep.true_view import TrueView
from testbed.lockstep.world import VISION_CLOCK_NS, SimulatedTimeLog, World
from testbed.scenarios.scenario import Settings
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.camera_feed import CameraFeed
from vision_pc.application.eyes import FrameEyes
from vision_pc.application.ports import CameraStatus, Runtime
from vision_pc.config.stereo_camera import StereoCalibration
from vision_pc.core.perception import intrinsics, markers
from vision_pc.core.perception.camera_errors import fitted_errors
from vision_pc.core.perception.intrinsics import as_believed, as_found
from vision_pc.core.perception.look import FrameMarkers, observation_of, priors_after
from vision_pc.core.perception.rectification import Rectifier
from vision_pc.core.perception.watch import Sensor
from vision_pc.core.pixel_sensor import FrozenPictures
from vision_pc.core.se3 import Array
from vision_pc.core.types import (
    CameraErrors,
    CameraFrame,
    CameraModel,
    FrameObservation,
    Image,
    StereoPair,
    WatchSample,
)

F = TypeVar("F", bound=CameraFrame)


class Sight(NamedTuple):
    """What eyes look with: a source of frames, and a sensor that measures in them."""

    frames: CameraFeed[Any]
    sensor: Sensor[Any]


class LockstepFrames(CameraFeed[F], ABC):
    """Vision's feed, filled from the world's exposures; in lockstep a frame arrives when it is sent."""

    def __init__(self, world: World) -> None:
        super().__init__(world.settings.vision.camera, world.clock)
        self._world = world
        self.connected()

    async def frame_after(self, capture_ns: int) -> F:
        """The port's, while which every exposure is taken."""
        viewers = self._world.camera.viewers
        viewers.append(self.exposed)
        try:
            return await super().frame_after(capture_ns)
        finally:
            viewers.remove(self.exposed)

    def status(self) -> CameraStatus:
        """The camera is always there, although it is only asked for frames while somebody looks."""
        return CameraStatus(True, 0.0, self._frames, self._world.settings.scene.camera.rate_hz)

    @abstractmethod
    def exposed(self, exposure: Exposure) -> None:
        """Publish the frame of ``exposure``, if it is delivered."""


class UndrawnPair(StereoPair):
    """A pair whose pictures are drawn when somebody looks at them first."""

    draw: Callable[[], StereoPair]

    @classmethod
    def of(cls, shot: Shot, draw: Callable[[], StereoPair]) -> "UndrawnPair":
        """The pair of ``shot``, on vision's clock."""
        nothing = np.empty((0, 0), dtype=np.uint8)
        pair = cls(nothing, nothing, shot.capture_ns + VISION_CLOCK_NS, shot.frame_id)
        pair.draw = lru_cache(draw)
        return pair

    @property
    def left(self) -> Image:
        """The left eye's picture."""
        return self.draw().left

    @property
    def right(self) -> Image:
        """The right eye's picture."""
        return self.draw().right

    def _replace(self, **changed: Any) -> StereoPair:  # type: ignore[override]
        return self.draw()._replace(**changed)


class PixelFrames(LockstepFrames[StereoPair]):
    """Stereo pairs, rectified where vision's calibration is a raw camera's; drawn when they are looked at."""

    def __init__(self, world: World) -> None:
        super().__init__(world)
        settings = world.settings.vision.camera
        known = settings.calibration
        self._rectified = Rectifier(known) if isinstance(known, StereoCalibration) else None
        self._pictures = FrozenPictures(settings.frozen_frames)

    def exposed(self, exposure: Exposure) -> None:
        """Publish the pair of ``exposure``."""
        shot = exposure.shot
        if shot.delivered:
            frozen = self._pictures.add(np.array([[shot.shown.frame_id]]))  # one capture is one picture
            self.publish(UndrawnPair.of(shot, partial(self._drawn, shot)), frozen=frozen)

    def _drawn(self, shot: Shot) -> StereoPair:
        left, right = self._world.camera.renderer.take(shot)
        pair = StereoPair(left, right, shot.capture_ns + VISION_CLOCK_NS, shot.frame_id)
        return self._rectified(pair) if self._rectified else pair


class SimulatedFrames(LockstepFrames[SimulatedFrame]):
    """Frames that carry what they would show in place of pictures."""

    def exposed(self, exposure: Exposure) -> None:
        """Publish what ``exposure`` shows, under its stamps."""
        shot = exposure.shot
        if shot.delivered:
            self.publish(SimulatedFrame(shot.shown, shot.capture_ns + VISION_CLOCK_NS, shot.frame_id))


SightMaker = Callable[[World], Sight]


def camera_eyes(world: World) -> CameraEyes:
    """Eyes on rendered pictures."""
    runtime = Runtime(world.clock, world.clock, world.clock)
    return CameraEyes(PixelFrames(world), world.link, world.settings.vision, runtime, SimulatedTimeLog(world))


def eyes_with(world: World, sight: Sight) -> FrameEyes[Any]:
    """Eyes that look with ``sight``."""
    runtime = Runtime(world.clock, world.clock, world.clock)
    return FrameEyes(*sight, world.link, world.settings.vision.look, runtime, SimulatedTimeLog(world))


_STREAM = 0x65796573  # the model's own random numbers


class CornerNoise(StrictModel):
    """What pictures do to a marker's corners, one coordinate in one eye.

    ``noise_px``: in one frame. ``bias_px``: of a corner at one place in the picture, shared by all frames
    that see it there. ``missed_share``: of markers that are whole in view, per frame.
    """

    noise_px: float = Field(ge=0.0, le=2.0)
    bias_px: float = Field(ge=0.0, le=2.0)
    missed_share: float = Field(ge=0.0, le=1.0)


class EyeModelConfig(StrictModel):
    """What was measured under one condition of light and texture."""

    corners: CornerNoise
    tracking: TrackingNoise


class EyeModelFile(StrictModel):
    """``eye_model.yaml``: measured in the pictures of ``usual`` scenarios and of ``harder`` ones."""

    usual: EyeModelConfig
    harder: EyeModelConfig


EyeCondition = Literal["usual", "harder"]


def load_eye_model(config_dir: Path, condition: EyeCondition = "usual") -> EyeModelConfig:
    """The measured parameters. Raises ConfigurationError."""
    measured = load(EyeModelFile, config_dir / "eye_model.yaml")
    return measured.usual if condition == "usual" else measured.harder


def simulated_sight(world: World, model: EyeModelConfig, seed: int) -> Sight:
    """Eyes without pictures on ``world``; bit-identical for a ``seed``.

    Raises ConfigurationError for a raw camera's calibration: nobody rectifies.
    """
    known = world.settings.vision.camera.calibration
    if isinstance(known, StereoCalibration):
        why = f"{known.source}: these eyes take no raw pairs, rendered pictures do (--eyes pixels)"
        raise ConfigurationError("configuration.raw_camera", f"vision.camera.calibration: {why}")
    return Sight(SimulatedFrames(world), SimulatedSensor(world.settings, model, seed))


class SimulatedSensor:
    """Implements ``vision_pc.core.perception.watch.Sensor`` in frames that carry the truth.

    Corners are projected through the true camera and made wrong as pictures would; all that follows (poses,
    covariances, refusals) is vision's own.
    """

    def __init__(self, settings: Settings, model: EyeModelConfig, seed: int) -> None:
        self.camera = intrinsics.calibration(settings.vision.camera)
        self._config = settings.vision
        self._model = model
        self._seed = seed
        self._view = TrueView(settings.scene.camera, Scene(settings.scene))
        self._rng = np.random.default_rng([seed, _STREAM])

    def observe(self, frame: SimulatedFrame, previous: FrameObservation | None) -> FrameObservation:
        """What vision makes of the corners that this frame would show."""
        settings = self._config.markers
        priors = priors_after(previous, settings)
        camera = as_found(self.camera, previous)
        sightings, unfit = [], dict[int, str]()
        for number, seen in sorted(self._view.markers(frame.shown).items()):
            if number not in settings.sizes or seen.left is None:
                continue
            if self._rng.random() < self._model.corners.missed_share:
                continue
            left = self._rays(camera.left, number, 0, seen.left)
            right = None if seen.right is None else self._rays(camera.right, number, 1, seen.right)
            start = markers.planar_start(number, left, settings)
            outcome = markers.from_rays(start, right, camera, settings, priors)
            if isinstance(outcome, str):
                unfit[number] = outcome
            else:
                sightings.append(outcome)
        found = FrameMarkers(sightings, Counter(), unfit, since_full_search=0)
        return observation_of(frame, found, camera, settings, priors, previous)

    def errors(self, samples: Sequence[WatchSample]) -> CameraErrors | None:
        """What the samples of a watch say of the camera."""
        return fitted_errors(samples, self.camera, self._config.markers)

    def odometry(self, previous: FrameObservation | None) -> ModelOdometry:
        """Odometry that begins with the next frame, for a camera as ``previous`` has it."""
        config = self._config
        return ModelOdometry(
            as_believed(self.camera, previous),
            config.odometry,
            config.markers.tool,
            self._model.tracking,
            self._view,
            self._rng,
        )

    def _rays(self, model: CameraModel, marker: int, eye: int, exact: Array) -> Array:
        """Rays (4, 2) of the corners as refined in the picture."""
        corners = self._model.corners
        pixels = np.rint(exact).astype(int).tolist()
        bias = [_standard_normal(self._seed, marker, 4 * eye + k, *at) for k, at in enumerate(pixels)]
        noise = self._rng.normal(0.0, corners.noise_px, (4, 2))
        return intrinsics.normalised(model, exact + corners.bias_px * np.array(bias) + noise)


@lru_cache(maxsize=4096)
def _standard_normal(*seed: int) -> Array:
    """Standard normal (2,), the same whenever a corner falls onto the same pixel."""
    return np.random.default_rng(seed).standard_normal(2)
