"""Vision's station in lockstep: the same programs as behind the REST face, without the face."""

import contextlib
import copy
import io
from collections.abc import Awaitable, Callable
from typing import Any

from protocol.errors import LinkLost, LongreachError
from protocol.faults import CommandCode
from testbed.demonstration.sequence import JSON
from testbed.lockstep.clock import run
from testbed.lockstep.eyes import LockstepEyes
from testbed.lockstep.run_log import RunLog
from testbed.lockstep.sight import Sight
from testbed.lockstep.world import World
from testbed.reporting.console import Bar
from testbed.scenarios.settings import Settings
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.schemas import (
    LocalTrackBody,
    LookBody,
    LookingAndMovingBody,
    LookThenMoveBody,
    MoveBody,
    OrientationBody,
    TrajectoryBody,
)
from vision_pc.application.station import Station
from vision_pc.config.vision import VisionConfig
from vision_pc.core.ports import Report
from vision_pc.shell import event_log
from vision_pc.shell.rest.operation_routes import with_overrides

SightMaker = Callable[[World, VisionConfig], Sight]
Program = Callable[[Report], Awaitable[JSON]]


class StationLog(event_log.EventLog):
    """The station's events, written to the run's log with simulated time."""

    def __init__(self, world: World) -> None:
        super().__init__(None, io.StringIO())
        self._world = world

    def write(self, event: str, **fields: Any) -> None:
        """Appends one event."""
        told = {("looked_ns" if key == "time_ns" else key): value for key, value in fields.items()}
        self._world.log.add(self._world.time_ns, event, **told)

    def __deepcopy__(self, memo: dict[int, Any]) -> "StationLog":
        """The log of a forked world: files and locks are left behind."""
        return StationLog(copy.deepcopy(self._world, memo))


class LockstepRig:
    """Implements ``testbed.demonstration.sequence.Rig`` over the station's programs in simulated time.

    ``sight``: what the eyes measure with in place of rendered pictures, such as ``eye_model.ModelSight``
    with its model and seed bound.
    """

    def __init__(self, settings: Settings, seed: int, log: RunLog, sight: SightMaker | None = None) -> None:
        self.world = World(settings, seed, log)
        self.link = self.world.link
        vision = settings.vision
        eyes = LockstepEyes(self.world, self.link, vision, sight(self.world, vision) if sight else None)
        arm = LinkArm(self.link, settings.vision.motion)
        self.station = Station(arm, eyes, self.link, eyes, settings.vision.programs, StationLog(self.world))
        self._eyes = eyes
        self.world.connect()

    def command(self, name: str) -> None:
        """Send the command. Returns when it is accepted."""
        run(self.link.command(CommandCode[name.upper().replace("-", "_")]))
        run(self.link.next_state())

    def operate(self, kind: str, body: JSON, bar: Bar) -> JSON:
        """The result of an operation; whatever ends it early stops the arm, as behind the REST face."""
        method = LookThenMoveBody(**body).method if kind == "look-then-move" else None
        self.station.refuse_now(kind, method)
        self.world.log.add(self.world.time_ns, "operation", kind=kind, body=body)
        try:
            result: JSON = run(_program(self.station, kind, body)(bar.update))
        except LongreachError as error:
            with contextlib.suppress(LinkLost):
                run(self.station.arm.halt())
            self.world.log.add(self.world.time_ns, "operation_failed", kind=kind, cause=error.cause)
            raise
        self.world.log.add(self.world.time_ns, "operation_ended", kind=kind, result=result)
        return result

    def latest_look(self) -> JSON:
        """The latest look of any operation."""
        return self.station.latest_look()

    def picture(self) -> bytes:
        """The newest picture with detections, PNG."""
        return run(self._eyes.latest_png())

    def now_ns(self) -> int:
        """The time on vision's clock."""
        return self.world.vision_ns


def _program(station: Station, kind: str, body: JSON) -> Any:
    """The station's program for an operation, its settings as the REST face would make them."""
    programs = station.settings
    if kind == "look":
        frames = LookBody(**body).frames
        return lambda report: station.look(frames, report)
    if kind == "orientation-adjustment":
        orientation = with_overrides(programs.orientation, OrientationBody(**body))
        return lambda report: station.adjust_orientation(orientation, report)
    if kind == "trajectory-matching":
        trajectory = with_overrides(programs.trajectory, TrajectoryBody(**body))
        return lambda report: station.trajectory_matching(trajectory, report)
    if kind == "local-track":
        local_map = with_overrides(programs.local_map, LocalTrackBody(**body))
        return lambda report: station.local_track(local_map, report)
    if kind == "look-then-move":
        asked = LookThenMoveBody(**body)
        positioning = with_overrides(programs.positioning, asked)
        return lambda report: station.look_then_move(positioning, asked.method, report)
    if kind == "looking-and-moving":
        wanted = LookingAndMovingBody(**body)
        loop = with_overrides(programs.looking_and_moving, wanted)
        usual = programs.positioning.clearance_m
        clearance_m = usual if wanted.clearance_m is None else wanted.clearance_m
        return lambda report: station.looking_and_moving(loop, clearance_m, report)
    if kind == "move":
        move = MoveBody(**body)
        return lambda report: station.move(move, report)
    raise ValueError(f"no operation '{kind}' in lockstep")
