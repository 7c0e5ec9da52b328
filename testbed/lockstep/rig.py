"""The vision application in lockstep: the programs of the same table as behind the API, without the API."""

import contextlib
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from pydantic import ValidationError

from controller.core.scan_program import Parts, own_parts
from controller.shell.scan_recorder import ScanRecorder
from foundation.event_log import Level
from foundation.recording.beginning import SESSION_VARIABLE, session_entries
from foundation.recording.messages import DirectRecording
from nominal_arm.dimensions import boom_dimensions, dimensions
from plant_emulator.core.camera.scene import Scene
from protocol.errors import LinkLost, LongreachError, RequestRefused
from protocol.faults import CommandCode
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.simulated_measurements import SightMaker, camera_eyes, eyes_with
from testbed.lockstep.world import World
from testbed.reporting.console import Bar
from testbed.scenarios.scenario import Settings
from vision_pc.application.application import VisionApplication
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.eyes import FrameEyes
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.hand_eye.steps import SessionStore, StartCheck
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.program import Program, by_name
from vision_pc.application.programs import PROGRAMS
from vision_pc.application.results import JSON
from vision_pc.core.se3 import Array
from vision_pc.core.targets.sighting import Click
from vision_pc.core.types import FrameObservation, Look
from vision_pc.shell.recording.recorded_ports import record_programs
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


class SimulatedTimeLog:
    """The application's events, written to the run's log with simulated time."""

    healthy = True
    record_dir = None

    def __init__(self, world: World) -> None:
        self._world = world
        self.listener: Callable[[str, Level, dict[str, Any]], object] | None = None

    def write(self, event: str, level: Level = "info", /, **fields: Any) -> None:
        """Append one event, and tell it to the listener."""
        self._world.log.add(self._world.time_ns, event, **fields)
        if self.listener is not None:
            self.listener(event, level, fields)


class LockstepRig:
    """Implements ``testbed.demonstration.sequence.Rig`` over the vision application in simulated time.

    Link, arm, eyes and programs are the service's own classes. ``sight``: what the eyes measure with in place
    of rendered pictures, such as ``simulated_sight`` with its model and seed bound.
    ``programs``: None for ours. ``parts``: as the World's.
    """

    def __init__(
        self,
        settings: Settings,
        seed: int,
        log: RunLog,
        sight: SightMaker | None = None,
        programs: Sequence[Program[Any, Any]] | None = None,
        parts: Parts = own_parts,
    ) -> None:
        self.world = World(settings, seed, log, parts)
        self.link = self.world.link
        vision = settings.vision
        self.camera = camera_eyes(self.world)
        self.eyes = eyes_with(self.world, sight(self.world)) if sight else self.camera
        arm = LinkArm(self.link, vision.motion)
        self._log = SimulatedTimeLog(self.world)
        boom = boom_dimensions(settings.arm)
        self.application = VisionApplication(
            arm, self.eyes, self.link, self.camera, vision.programs, boom, self._log
        )
        self._programs = by_name(PROGRAMS if programs is None else programs)
        self.world.connect()

    def record_in(self, directory: Path, session: str) -> LockstepRecordings:
        """Record all three parts below ``directory`` from now on, until what is returned is closed.

        Raises OSError or ConfigurationError where a file cannot be made.
        """
        recordings = LockstepRecordings(directory, session, self.world, self.eyes)
        record_programs(self.application, recordings.vision)
        self._log.listener = recordings.vision.event
        return recordings

    def command(self, name: str) -> None:
        """Send the command. Returns when it is accepted."""
        run(self.link.command(CommandCode[name.upper().replace("-", "_")]))
        run(self.link.next_state())

    def operate(self, kind: str, body: JSON, bar: Bar) -> Any:
        """The typed result of a program; whatever ends it early stops the arm, as behind the API.

        Raises RequestRefused for a program that there is not (``refused.unknown_program``) and for a body
        that the API would not take (``request.invalid``).
        """
        if kind not in self._programs:
            known = ", ".join(self._programs)
            why = f"no program {kind}; known: {known}"
            raise RequestRefused("refused.unknown_program", why)
        program = self._programs[kind]
        try:
            asked = program.body(**body)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, (kind, *first["loc"])))
            raise RequestRefused("request.invalid", f"{where}: {first['msg']}") from error
        settings = program.requested(self.application, asked)
        program.refuse_now(self.application, settings)
        self._log.write("operation", kind=kind, body=body)
        try:
            result: Any = run(program.run(self.application, settings, bar.update))
        except LongreachError as error:
            with contextlib.suppress(LinkLost):
                run(self.application.arm.halt())
            self._log.write("operation_failed", kind=kind, cause=error.cause)
            raise
        ended = program.to_json(result)
        self._log.write("operation_ended", kind=kind, result=ended)
        return result

    def latest_look(self) -> Look:
        """The latest look of any program."""
        return self.application.latest_look.look

    def holes(self) -> list[tuple[Array, Array]]:
        """All drill holes of the newest picture: middle in the left eye's, px (2,), and in C (3,)."""
        _, found = run(self.camera.detected_holes(None))
        return [(hole.outline.mean(axis=0), hole.X_CO[:3, 3]) for hole in found]

    def target_at(self, pixel: Array) -> str:
        """The id of the hole at ``pixel`` (2,) of a fresh left picture, from now on a target."""
        return run(self.camera.target_at(Click("left", pixel, "hole"), None)).id

    def picture(self) -> bytes:
        """The newest picture with detections, PNG."""
        return run(self.camera.latest_png())

    def now_ns(self) -> int:
        """The time on vision's clock."""
        return self.world.vision_ns


class GuidedRig:
    """World, arm, camera and session. The arm is enabled and at rest in its starting pose."""

    def __init__(self, settings: Settings, seed: int, sessions: Path) -> None:
        self.world = World(settings, seed, RunLog())
        self.settings = settings
        self.link = self.world.link
        self.eyes = camera_eyes(self.world)
        self.arm = LinkArm(self.link, settings.vision.motion)
        log = SimulatedTimeLog(self.world)
        store = SessionStore(sessions)
        self.guided = GuidedCalibration(
            self.arm, self.eyes, self.link, settings.vision, dimensions(settings.arm), log, store
        )
        self.world.connect()
        self.run(self.link.command(CommandCode.ENABLE))
        self.run(self.link.next_state())

    @property
    def X_TC(self) -> Array:
        """The camera in the hand as it truly is."""
        return Scene(self.settings.scene).mounts.X_TC

    def run(self, program: Awaitable[T]) -> T:
        """The result of a program in simulated time."""
        return run(program)  # type: ignore[arg-type]


def quiet(_progress: float, _note: str) -> None:
    """A report that nobody reads."""


def start(rig: GuidedRig, name: str, seed: int) -> StartCheck:
    """Begins a session and takes its first sample where the arm stands."""
    check = rig.run(rig.guided.start(name, rig.guided.defaults, seed, quiet))
    rig.run(rig.guided.sample(quiet))
    return check
