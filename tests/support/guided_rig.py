"""A guided hand-eye session on the simulated hydraulic arm, for tests and pinned runs."""

from collections.abc import Coroutine
from pathlib import Path
from typing import Any, TypeVar

from nominal_arm.dimensions import dimensions
from plant_emulator.core.camera.scene import Scene
from protocol.faults import CommandCode
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.simulated_measurements import camera_eyes
from testbed.lockstep.world import SimulatedTimeLog, World
from testbed.scenarios.scenario import Settings
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.hand_eye.session_store import SessionStore
from vision_pc.application.link_arm import LinkArm
from vision_pc.core.se3 import Array

T = TypeVar("T")


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

    def run(self, program: Coroutine[Any, Any, T]) -> T:
        """The result of a program in simulated time."""
        return run(program)


def quiet(_progress: float, _note: str) -> None:
    """A report that nobody reads."""


def start(rig: GuidedRig, name: str, seed: int) -> dict[str, Any]:
    """Begins a session and takes its first sample where the arm stands."""
    check = rig.run(rig.guided.start(name, rig.guided.defaults, seed, quiet))
    rig.run(rig.guided.sample(quiet))
    return check
