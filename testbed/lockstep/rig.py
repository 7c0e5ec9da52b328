"""The vision application in lockstep: the programs of the same table as behind the API, without the API."""

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from foundation.event_log import Level
from nominal_arm.dimensions import boom_dimensions
from protocol.errors import LinkLost, LongreachError, RequestRefused
from protocol.faults import CommandCode
from testbed.lockstep.clock import run
from testbed.lockstep.eyes import SightMaker, camera_eyes, eyes_with
from testbed.lockstep.recordings import LockstepRecordings
from testbed.lockstep.run_log import RunLog
from testbed.lockstep.world import World
from testbed.reporting.console import Bar
from testbed.scenarios.settings import Settings
from vision_pc.application.application import VisionApplication
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.program import Program, by_name
from vision_pc.application.results import JSON
from vision_pc.core.se3 import Array
from vision_pc.core.targets.sighting import Click
from vision_pc.core.types import Look
from vision_pc.shell.installed_programs import every_program, installed_programs
from vision_pc.shell.recording.recorded_ports import record_programs


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
    ``programs``: None for ours and those of installed packages.
    """

    def __init__(
        self,
        settings: Settings,
        seed: int,
        log: RunLog,
        sight: SightMaker | None = None,
        programs: Sequence[Program[Any, Any]] | None = None,
    ) -> None:
        self.world = World(settings, seed, log)
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
        self._programs = by_name(every_program() if programs is None else programs)
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
            why = f"no program {kind}; known: {known}{installed_programs().why_not(kind)}"
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
