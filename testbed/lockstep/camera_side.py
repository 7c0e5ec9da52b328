"""The cameras' side of a lockstep run: its exposures."""

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

from plant_emulator.core.camera.exposures import STILL, CameraMotion, CameraView, Capture, Exposures, Shot
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from testbed.scenarios.scenario import Settings


class Exposure(NamedTuple):
    """One instant at which the camera exposes: what was true, and the frame that it makes of it.

    ``motion``: how camera and marker moved, where the camera's pictures depend on it.
    """

    truth: PlantTruth
    shot: Shot
    motion: CameraMotion | None = None


class CameraSide:
    """The camera of one world. ``viewers`` are called with every exposure; nothing is rendered unasked."""

    def __init__(self, settings: Settings) -> None:
        self.period_ns = round(1e9 / settings.scene.camera.rate_hz)
        self.viewers: list[Callable[[Exposure], None]] = []
        self._config = settings.scene.camera
        self._seed = settings.scene.seed
        self._scene = Scene(settings.scene)
        self._exposures = Exposures(self._config, self._seed)

    def expose(self, time_ns: int, plant: Plant) -> Exposure:
        """The exposure at ``time_ns``, a multiple of the period, which the viewers are shown."""
        truth = plant.truth()
        motion = plant.motion() if self._config.shows_motion else None
        view = CameraView(truth.X_WC, truth.X_WM, truth.X_WO)
        capture = Capture(time_ns // self.period_ns, time_ns, view, STILL if motion is None else motion)
        exposure = Exposure(truth, self._exposures.shot(capture, plant.faults.in_force()), motion)
        for viewer in list(self.viewers):
            viewer(exposure)
        return exposure

    @cached_property
    def renderer(self) -> StereoCamera:
        """What renders this camera's pictures, made when first asked for."""
        return StereoCamera(self._config, self._scene, self._seed)
