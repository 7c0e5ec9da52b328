"""Eyes without pictures, for long campaigns: the true camera's geometry with the errors that pictures make.

What is drawn at random is only what pictures add: noise and bias of marker corners, noise of tracked points,
depths of the map's points, failures. All of it was measured from rendered pictures (``longreach experiment
eyes-measure`` writes ``configs/eye_model.yaml``). Everything else is exact or vision's own: true lenses,
rectification, prints and what hides what on one side; poses, covariances, offset and looks on the other.
"""

from collections import Counter
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from foundation.configuration import StrictModel, load
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.truth import PlantTruth
from testbed.lockstep.sight import Deliver
from testbed.lockstep.simulated_odometry import ModelOdometry, TrackingNoise
from testbed.lockstep.true_view import TrueView
from testbed.lockstep.world import VISION_CLOCK_NS, World
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception import intrinsics, markers
from vision_pc.core.perception.look import beliefs_after, observation_of
from vision_pc.core.perception.watch import Watcher
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, EyeModel, FrameObservation, OdometryPose, StereoPair

_STREAM = 0x65796573  # the model's own random numbers
_NO_PICTURE = np.zeros((0, 0), dtype=np.uint8)


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


def load_eye_model(config_dir: Path, condition: Literal["usual", "harder"] = "usual") -> EyeModelConfig:
    """The measured parameters. Raises ConfigurationError."""
    measured = load(EyeModelFile, config_dir / "eye_model.yaml")
    return measured.usual if condition == "usual" else measured.harder


class ModelSight:
    """Implements ``testbed.lockstep.sight.Sight`` from the truth of each exposure; bit-identical for a seed.

    Pairs carry no pictures, only their number, under which the truth of their exposure is kept until the
    next look or watch begins.
    """

    def __init__(self, world: World, config: VisionConfig, model: EyeModelConfig, seed: int) -> None:
        self._world = world
        self._config = config
        self._model = model
        self._seed = seed
        self._camera = intrinsics.calibration(config.camera)
        self._view = TrueView(world.settings.scene.camera, Scene(world.settings.scene))
        self._rng = np.random.default_rng([seed, _STREAM])
        self._truths: dict[int, PlantTruth] = {}

    def begin(self, deliver: Deliver) -> None:
        """Start to hand on every exposure."""
        self._truths.clear()

        def exposed(number: int, truth: PlantTruth) -> None:
            self._truths[number] = truth
            deliver(StereoPair(_NO_PICTURE, _NO_PICTURE, truth.time_ns + VISION_CLOCK_NS, number))

        self._world.on_exposure = exposed

    def end(self) -> None:
        """Stop handing on exposures."""
        self._world.on_exposure = None

    def observe(self, pair: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """What vision makes of the corners that this pair would show."""
        settings = self._config.markers
        beliefs = beliefs_after(previous, settings)
        sightings, unfit = [], dict[int, str]()
        truth = self._truths[pair.frame_id]
        for number, seen in sorted(self._view.markers(truth.X_WC, truth.X_WM).items()):
            if number not in settings.sizes or seen.left is None or self._misses():
                continue
            left = self._rays(number, 0, seen.left)
            right = None if seen.right is None else self._rays(number, 1, seen.right)
            outcome = markers.from_rays(number, left, _Same(right), self._camera, settings, beliefs)
            if isinstance(outcome, str):
                unfit[number] = outcome
            else:
                sightings.append(outcome)
        frame = (pair.capture_ns, pair.frame_id)
        return observation_of(frame, sightings, Counter(), unfit, self._camera, settings, beliefs, previous)

    def watcher(self, *, markers: bool, odometry: bool, previous: FrameObservation | None) -> Watcher:
        """A watcher over this sight's measurements."""
        return _ModelWatcher(self, markers=markers, odometry=odometry, previous=previous)

    def new_odometry(self, camera: CameraCalibration) -> "_FrameOdometry":
        """Odometry that begins with the next frame, for a ``camera`` as vision believes it to be."""
        config = self._config
        odometry = ModelOdometry(
            camera, config.odometry, config.markers.tool, self._model.tracking, self._view, self._rng
        )
        return _FrameOdometry(odometry, self._truths)

    @property
    def camera(self) -> CameraCalibration:
        """Vision's calibration."""
        return self._camera

    @property
    def config(self) -> VisionConfig:
        """Vision's configuration."""
        return self._config

    def _misses(self) -> bool:
        return bool(self._rng.random() < self._model.corners.missed_share)

    def _rays(self, marker: int, eye: int, exact: Array) -> Array:
        """Rays (4, 2) of the corners as refined in the picture."""
        corners = self._model.corners
        bias = [self._bias(marker, 4 * eye + k, pixel) for k, pixel in enumerate(exact)]
        noise = self._rng.normal(0.0, corners.noise_px, (4, 2))
        model: EyeModel = (self._camera.left, self._camera.right)[eye]
        return intrinsics.normalised(model, exact + corners.bias_px * np.array(bias) + noise)

    def _bias(self, marker: int, corner: int, pixel: Array) -> Array:
        """Standard normal (2,), the same whenever this corner falls onto the same pixel."""
        at = np.rint(pixel).astype(int)
        return np.random.default_rng([self._seed, marker, corner, int(at[0]), int(at[1])]).standard_normal(2)


class _Same:
    """The right eye's rays, wherever they are expected."""

    def __init__(self, rays: Array | None) -> None:
        self._rays = rays

    def __call__(self, X_CA: Array) -> Array | None:
        return self._rays


class _FrameOdometry:
    """``ModelOdometry`` as a watch uses it: told pairs, it finds their truths."""

    def __init__(self, odometry: ModelOdometry, truths: dict[int, PlantTruth]) -> None:
        self._odometry = odometry
        self._truths = truths

    @property
    def last_loss(self) -> str | None:
        """Why the last frame was lost, None if it was not."""
        return self._odometry.last_loss

    def process(self, pair: StereoPair, X_CM: Array | None = None) -> OdometryPose | None:
        """The camera's pose at ``pair``, None when it is lost."""
        return self._odometry.process(self._truths[pair.frame_id], X_CM, pair.capture_ns, pair.frame_id)


class _ModelWatcher(Watcher):
    """Vision's watcher over the model's measurements."""

    def __init__(
        self, sight: ModelSight, *, markers: bool, odometry: bool, previous: FrameObservation | None
    ) -> None:
        super().__init__(sight.camera, sight.config, markers=markers, odometry=odometry, previous=previous)
        self._sight = sight

    def observe(self, pair: StereoPair, previous: FrameObservation | None) -> FrameObservation:
        """What the model says of ``pair``."""
        return self._sight.observe(pair, previous)

    def new_odometry(self, camera: CameraCalibration) -> _FrameOdometry:
        """The model's odometry."""
        return self._sight.new_odometry(camera)
