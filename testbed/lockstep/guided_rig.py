"""A guided hand-eye session in lockstep: the vision PC's own steps over the simulated arm and pictures."""

from collections.abc import Awaitable
from pathlib import Path
from typing import TypeVar

from nominal_arm.dimensions import dimensions
from plant_emulator.core.camera.scene import Scene
from protocol.errors import MeasurementFailed, MotionUnsettled, RequestRefused
from protocol.faults import CommandCode
from testbed.lockstep.clock import run
from testbed.lockstep.eyes import camera_eyes
from testbed.lockstep.rig import SimulatedTimeLog
from testbed.lockstep.run_log import RunLog
from testbed.lockstep.world import World
from testbed.scenarios.settings import Settings
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.hand_eye.sensing import ended_in_fault
from vision_pc.application.hand_eye.steps import SessionStore, StartCheck
from vision_pc.application.link_arm import LinkArm
from vision_pc.core.se3 import Array

T = TypeVar("T")
_PATIENCE = 10  # samples that may fail in a session


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


def take_all(rig: GuidedRig, informative: bool) -> int:
    """Samples until the session is complete, each at the pose proposed; how many faults interrupted it."""
    spoiled = faults = 0
    while not rig.guided.session.complete:
        try:
            rig.run(rig.guided.next_pose(quiet, informative))
            rig.run(rig.guided.sample(quiet))
        except (MeasurementFailed, MotionUnsettled):  # a hidden marker, an arm that swings: the next pose
            spoiled += 1
            if spoiled > _PATIENCE:
                raise
        except RequestRefused as error:
            faults += 1
            if not ended_in_fault(error) or faults > _PATIENCE:
                raise
            recover(rig)
    return faults


def recover(rig: GuidedRig) -> None:
    """What an operator does after a fault: RESET, again while the arm still ramps down, then ENABLE."""
    while True:
        try:
            rig.run(rig.link.command(CommandCode.RESET))
        except RequestRefused as error:
            if error.cause != "refused.stopping":
                raise
            rig.run(rig.link.next_state())
        else:
            break
    rig.run(rig.link.next_state())
    rig.run(rig.link.command(CommandCode.ENABLE))
    rig.run(rig.link.next_state())
