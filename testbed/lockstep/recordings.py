"""The recordings of a run in simulated time: the same three files as the services write, of one session.

All times are those of each part's own clock. The same run gives the same bytes.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from controller.shell.scan_recorder import ScanRecorder
from foundation.recording.recording_thread import DirectRecording
from foundation.recording.session import SESSION_VARIABLE, session_entries
from testbed.lockstep.run_log import RunLog
from testbed.lockstep.world import World
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.eyes import FrameEyes
from vision_pc.core.types import FrameObservation, Look
from vision_pc.shell.recording.vision_recorder import EYES, FILE, SIMULATED, VisionRecorder

TRUTH = Path("plant_emulator") / "truth.mcap"
CONTROLLER = Path("controller")
VISION = Path("vision_pc") / FILE
T = TypeVar("T")


class SimulatedJournal:
    """Where the controller's recorder says that nothing more can be written: in the run's log."""

    def __init__(self, log: RunLog) -> None:
        self._log = log

    def write(self, event: str, level: str = "info", /, **fields: object) -> None:
        """Append one event."""
        self._log.add(0, event, **fields)


class LooksAlone:
    """Implements ``SightRecorder`` for eyes without pictures: their looks alone are recorded."""

    def __init__(self, recorder: VisionRecorder) -> None:
        self._recorder = recorder

    def tapped(self, sensor: T) -> T:
        """The sensor itself."""
        return sensor

    def looked(self, look: Look, observations: Sequence[FrameObservation]) -> None:
        """Record a look, made of nothing that is recorded."""
        self._recorder.looked(look, ())


class Closed(Protocol):
    """What is closed at the end."""

    def close(self) -> None: ...


class LockstepRecordings:
    """Records plant, controller and vision below ``directory``, as `longreach up` lays it out.

    ``eyes``: whose measurements are recorded, of eyes without pictures their looks. ``vision`` is their
    recorder.
    """

    def __init__(self, directory: Path, session: str, world: World, eyes: FrameEyes[Any]) -> None:
        """Create the files. Raises FileExistsError where one exists, OSError, ConfigurationError."""
        settings = world.settings
        for name in (TRUTH.parent, CONTROLLER, VISION.parent):
            (directory / name).mkdir(parents=True, exist_ok=True)
        said = {SESSION_VARIABLE: session}
        world.record_in(directory / TRUTH, session)
        assert world.recording is not None
        self._closing: list[Closed] = [world.recording]
        if settings.controller.recording_hz > 0.0:
            world.controller.recorder = ScanRecorder(
                directory / CONTROLLER,
                settings.arm,
                settings.controller,
                SimulatedJournal(world.log),
                session=session_entries("controller", said),
                made=DirectRecording,
            )
            self._closing.append(world.controller.recorder)
        run = {name: getattr(settings, name).model_dump(mode="json") for name in ("arm", "vision")}
        pictured = isinstance(eyes, CameraEyes)
        entries = session_entries("vision_pc", said) | ({} if pictured else {EYES: SIMULATED})
        self.vision = VisionRecorder(
            directory / VISION, settings.vision, run, entries, lambda: world.vision_ns, DirectRecording
        )
        self._closing.append(self.vision)
        self.vision.listen_to(world.link)
        eyes.recorded_by(self.vision if pictured else LooksAlone(self.vision))

    def close(self) -> None:
        """Write the summaries and close the files."""
        for each in self._closing:
            each.close()
