"""The plant's recording of a run in simulated time: the same file as the emulator's process writes."""

from pathlib import Path

from foundation.recording.recording_thread import DirectRecording
from foundation.recording.session import SESSION_VARIABLE, session_entries
from plant_emulator.core.faults.schedule import FaultChange
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from plant_emulator.shell.scene_messages import drawing
from plant_emulator.shell.truth_recorder import TruthRecorder
from testbed.lockstep.camera_side import CameraSide, Exposure
from testbed.scenarios.settings import Settings


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
        camera.viewers.append(self._exposed)

    def truth(self, truth: PlantTruth) -> None:
        """Record a regular truth."""
        if truth.time_ns % self._camera.period_ns:
            self._recorder.truth(truth, truth.time_ns, self._plant.links())

    def fault(self, change: FaultChange) -> None:
        """Record a step in the life of a fault."""
        self._recorder.fault(change, change.time_ns)

    def close(self) -> None:
        """Write the summary and close the file."""
        self._camera.viewers.remove(self._exposed)
        self._recorder.close()

    def _exposed(self, exposure: Exposure) -> None:
        truth, links = exposure.truth, self._plant.links()
        self._recorder.capture(truth, truth.time_ns, exposure.shot.frame_id, links, exposure.motion)
