"""The vision application in lockstep: the programs of the same table as behind the API, without the API."""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from controller.core.scan_program import Parts, own_parts
from controller.shell.scan_recorder import ScanRecorder
from foundation.configuration import fault_words
from foundation.recording.beginning import SESSION_VARIABLE, session_entries
from foundation.recording.messages import DirectRecording
from nominal_arm.dimensions import boom_dimensions
from protocol.errors import LinkLost, LongreachError, RequestRefused
from protocol.faults import CommandCode
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.simulated_measurements import SightMaker, camera_eyes, eyes_with
from testbed.lockstep.world import SimulatedTimeLog, World
from testbed.reporting.console import Bar
from testbed.scenarios.scenario import Settings
from vision_pc.application.application import VisionApplication
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.program import Program, by_name
from vision_pc.application.programs import PROGRAMS
from vision_pc.application.results import JSON
from vision_pc.core.se3 import Array
from vision_pc.core.types import Look
from vision_pc.shell.recording.vision_recorder import EYES, FILE, SIMULATED, VisionRecorder

TRUTH = Path("plant_emulator") / "truth.mcap"
CONTROLLER = Path("controller")
VISION = Path("vision_pc") / FILE


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
        self._result: JSON = {}
        self._programs = by_name(PROGRAMS if programs is None else programs)
        self.world.connect()

    def record_in(self, directory: Path, session: str) -> contextlib.ExitStack:
        """Record all three parts below ``directory``, as `longreach up` lays it out, from now on until what
        is returned is closed.

        Raises FileExistsError where a file exists, OSError or ConfigurationError where none can be made.
        """
        world, settings, entries = self.world, self.world.settings, {SESSION_VARIABLE: session}
        for path in (TRUTH.parent, CONTROLLER, VISION.parent):
            (directory / path).mkdir(parents=True, exist_ok=True)
        files = contextlib.ExitStack()
        files.callback(world.record_in(directory / TRUTH, session).close)
        if settings.controller.recording_hz > 0.0:
            world.controller.recorder = ScanRecorder(
                directory / CONTROLLER,
                settings.arm,
                settings.controller,
                session=session_entries("controller", entries),
                made=DirectRecording,
            )
            files.callback(world.controller.recorder.close)
        pictured = isinstance(self.eyes, CameraEyes)
        eyes = {} if pictured else {EYES: SIMULATED}
        recorder = VisionRecorder(
            directory / VISION,
            settings.vision,
            {name: getattr(settings, name).model_dump(mode="json") for name in ("arm", "vision")},
            session_entries("vision_pc", entries) | eyes,
            lambda: world.vision_ns,
            DirectRecording,
        )
        files.callback(recorder.close)
        recorder.listen_to(world.link)
        if pictured:
            self.camera.recorded_by(recorder)
        self._log.listener = recorder.event
        return files

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
            request_body = program.body(**body)
        except ValidationError as error:
            raise RequestRefused("request.invalid", f"{kind}.{fault_words(error.errors()[0])}") from error
        settings = program.requested(self.application, request_body)
        program.refuse_now(self.application, settings)
        self._log.write("operation", kind=kind, body=body)
        try:
            result: Any = run(program.run(self.application, settings, bar.update))
        except LongreachError as error:
            with contextlib.suppress(LinkLost):
                run(self.application.arm.halt())
            self._log.write("operation_failed", kind=kind, cause=error.cause)
            raise
        self._result = program.to_json(result)
        self._log.write("operation_ended", kind=kind, result=self._result)
        return result

    def result(self, kind: str, body: JSON, bar: Bar) -> JSON:
        """The result of a program as the API gives it; else as ``operate``."""
        self.operate(kind, body, bar)
        return self._result

    def latest_look(self) -> Look:
        """The latest look of any program."""
        return self.application.latest_look.look

    def holes(self) -> list[tuple[Array, Array]]:
        """All drill holes of the newest picture: middle in the left eye's, px (2,), and in C (3,)."""
        _, found = run(self.camera.detected_holes(None))
        return [(hole.outline.mean(axis=0), hole.X_CO[:3, 3]) for hole in found]

    def picture(self) -> bytes:
        """The newest picture with detections, PNG."""
        return run(self.camera.latest_png())

    def now_ns(self) -> int:
        """The time on vision's clock."""
        return self.world.vision_ns
