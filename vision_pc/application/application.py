"""The vision application: arm, eyes, controller and camera put together, and what programs have found out.

The programs themselves are rows of ``programs.PROGRAMS``. Nothing here reads a socket, a file or a clock.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any

from foundation.incidents import ServiceIncident
from nominal_arm.dimensions import BoomDimensions, DhLink
from protocol.errors import RequestRefused
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.link_arm import CarryingArm
from vision_pc.application.ports import Camera, Controller, HealthyLog, StoppableArm
from vision_pc.application.results import JudgedLook, look_json
from vision_pc.config.programs import ProgramSettings
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.local_error_model import LocalTrack
from vision_pc.core.ports import Eyes, Watch
from vision_pc.core.positioning.look_then_move import judge
from vision_pc.core.types import Look


class ReportingEyes:
    """Eyes that call ``on_look`` with every look before the program gets it."""

    def __init__(self, eyes: Eyes, on_look: Callable[[Look], None]) -> None:
        self.seeing = eyes
        self._on_look = on_look

    async def look(self, frames: int | None = None) -> Look:
        """Take a look, report it and return it."""
        look = await self.seeing.look(frames)
        self._on_look(look)
        return look

    def watch(self, *, markers: bool, odometry: bool) -> AbstractAsyncContextManager[Watch]:
        """A watch of the eyes themselves."""
        return self.seeing.watch(markers=markers, odometry=odometry)


class VisionApplication:
    """One rig, and what its programs have learned since the start.

    ``calibration`` and ``track`` are the newest local calibration and local track, None before the first.
    ``positioning`` are the settings by which looks are judged. ``hand_eye`` is the guided session, if there
    is one on this rig. ``overload`` returns one sentence while the machine is overloaded, else nothing,
    ``figures`` what the service counts of itself, ``looks`` how many were taken, ``incidents`` what became of
    the services themselves, the oldest first. ``links`` are those of
    the arm's drawing, for who draws it. ``times_anew``: how often the machine has begun anew.
    """

    def __init__(
        self,
        arm: StoppableArm,
        eyes: Eyes,
        controller: Controller,
        camera: Camera,
        settings: ProgramSettings,
        dimensions: BoomDimensions,
        log: HealthyLog,
        hand_eye: GuidedCalibration | None = None,
    ) -> None:
        self._carrying = CarryingArm(arm, eyes, camera)
        self.arm: StoppableArm = self._carrying
        self.eyes = ReportingEyes(eyes, self._remember)
        self.controller = controller
        self.camera = camera
        self.settings = settings
        self.dimensions = dimensions
        self.log = log
        self.hand_eye = hand_eye
        self.calibration: LocalCalibration | None = None
        self.track: LocalTrack | None = None
        self.positioning = settings.positioning
        self.overload: Callable[[], str] = str
        self.figures: Callable[[], dict[str, Any]] = dict
        self.incidents: Callable[[], Sequence[ServiceIncident]] = tuple
        self.links: tuple[DhLink, ...] = ()
        self.looks = 0
        self.times_anew = 0
        self._latest: JudgedLook | None = None

    def tap(self, arm: Callable[[StoppableArm], StoppableArm], eyes: Callable[[Eyes], Eyes]) -> None:
        """Have programs reach arm and eyes through what ``arm`` and ``eyes`` make of them: recorders."""
        self._carrying.driven = arm(self._carrying.driven)
        self._carrying.watching = self.eyes.seeing = eyes(self.eyes.seeing)

    @property
    def guided(self) -> GuidedCalibration:
        """The guided hand-eye session. Raises RequestRefused (``refused.hand_eye.none``) without one."""
        if self.hand_eye is None:
            raise RequestRefused("refused.hand_eye.none", "this rig has no guided hand-eye calibration")
        return self.hand_eye

    @property
    def latest_look(self) -> JudgedLook:
        """The latest look of any program. Raises RequestRefused (``refused.no_look_yet``)."""
        if self._latest is None:
            raise RequestRefused(
                "refused.no_look_yet", "nothing was looked at since service and machine started"
            )
        return self._latest

    def begin_anew(self) -> None:
        """Forget what holds for one run of the machine: local calibrations, the look, targets' places."""
        self.calibration = self.track = self._latest = None
        self.camera.targets.lose()
        self.controller.begin_anew()
        self.times_anew += 1
        lost = [kept.id for kept in self.camera.targets.list()]
        self.log.write("machine_begun_anew", "warning", targets_lost=lost)

    async def look_alone(self, frames: int | None) -> JudgedLook:
        """A look without a controller, remembered as any other. Raises as ``Camera.look_alone``."""
        self._remember(await self.camera.look_alone(frames))
        return self.latest_look

    def _remember(self, look: Look) -> None:
        self._latest = JudgedLook(look, judge(look, self.positioning))
        self.looks += 1
        shown = look_json(self._latest)
        self.log.write("look", looked_ns=shown.pop("time_ns"), **shown)
