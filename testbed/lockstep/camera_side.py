"""The cameras' side of a lockstep run: exposures, and the truth recorded with them."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from foundation.recording.beginning import SESSION_VARIABLE, session_entries
from foundation.recording.messages import DirectRecording
from plant_emulator.core.camera.exposures import STILL, CameraMotion, CameraView, Capture, Exposures, Shot
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.faults.schedule import FaultChange
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from plant_emulator.shell.scene_messages import drawing
from plant_emulator.shell.truth_recorder import TruthRecorder
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
        self._renderer: StereoCamera | None = None

    def expose(self, time_ns: int, plant: Plant) -> None:
        """Take the frame of ``time_ns``, a multiple of the period, and show it to the viewers."""
        truth = plant.truth()
        motion = plant.motion() if self._config.shows_motion else None
        view = CameraView(truth.X_WC, truth.X_WM, truth.X_WO)
        number = time_ns // self.period_ns
        capture = Capture(number, time_ns, view, STILL if motion is None else motion)
        exposure = Exposure(truth, self._exposures.shot(capture, plant.faults.in_force()), motion)
        for viewer in list(self.viewers):
            viewer(exposure)

    @property
    def renderer(self) -> StereoCamera:
        """What renders this camera's pictures, made when first asked for."""
        if self._renderer is None:
            self._renderer = StereoCamera(self._config, self._scene, self._seed)
        return self._renderer


class LockstepRecording:
    """Records a plant as it is told of it; a capture instant takes the place of a regular one.

    All times are the simulated time. The same run gives the same bytes.
    """

    def __init__(
        self, path: Path, session: str, settings: Settings, plant: Plant, camera: CameraSide
    ) -> None:
        """Create ``path``. Raises FileExistsError where it exists, OSError when it cannot be written."""
        parts = {"plant": settings.plant, "scene": settings.scene}
        run = {name: part.model_dump(mode="json") for name, part in parts.items()}
        drawn = drawing(settings.scene, plant.chain, plant.time_ns)
        entries = session_entries("plant_emulator", {SESSION_VARIABLE: session})
        self._recorder = TruthRecorder(path, run, drawn, entries, DirectRecording)
        self._plant = plant
        self._camera = camera
        camera.viewers.append(self._expose)

    def truth(self, truth: PlantTruth) -> None:
        """Record a regular truth."""
        if truth.time_ns % self._camera.period_ns:
            self._recorder.truth(truth, truth.time_ns, self._plant.links())

    def fault(self, change: FaultChange) -> None:
        """Record a step in the life of a fault."""
        self._recorder.fault(change, change.time_ns)

    def close(self) -> None:
        """Write the summary and close the file."""
        self._camera.viewers.remove(self._expose)
        self._recorder.close()

    def _expose(self, exposure: Exposure) -> None:
        truth, links = exposure.truth, self._plant.links()
        self._recorder.capture(truth, truth.time_ns, exposure.shot.frame_id, links, exposure.motion)
