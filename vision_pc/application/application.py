"""The vision application: arm, eyes, controller and camera put together, and what programs have found out.

The programs themselves are rows of ``programs.PROGRAMS``. Nothing here reads a socket, a file or a clock.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any

from foundation.incidents import ServiceIncident
from nominal_arm.dimensions import BoomDimensions, DhLink
from protocol.errors import RequestRefused
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.link_arm import CarryingArm
from vision_pc.application.ports import HealthyLog, StoppableArm
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.application.results import JudgedLook, doubt_json, look_json
from vision_pc.config.programs import ProgramSettings
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.local_error_model import LocalTrack
from vision_pc.core.ports import Eyes, Watch
from vision_pc.core.positioning.doubt import DoubtKeeper
from vision_pc.core.positioning.look_then_move import judge
from vision_pc.core.types import Contradiction, Look


class ReportingEyes:
    """Eyes that return what ``on_look`` makes of every look."""

    def __init__(self, eyes: Eyes, on_look: Callable[[Look], Look]) -> None:
        self._eyes = eyes
        self._on_look = on_look

    async def look(self, frames: int | None = None) -> Look:
        """Take a look, report it and return it."""
        return self._on_look(await self._eyes.look(frames))

    def watch(self, *, markers: bool, odometry: bool) -> AbstractAsyncContextManager[Watch]:
        """A watch of the eyes themselves."""
        return self._eyes.watch(markers=markers, odometry=odometry)


class VisionApplication:
    """One rig, and what its programs have learned since the start.

    ``calibration``, ``track`` and ``newest_look`` are the newest local calibration, local track and look,
    None before the first. ``positioning`` are the settings by which looks are judged. ``hand_eye`` is the
    guided session, if there is one on this rig. ``metrics`` returns what the service counts of itself,
    ``incidents`` what became of the services themselves, the oldest first; ``looks`` is how many were taken.
    ``links`` are those of the arm's drawing, for who draws it. ``times_anew``: how often the machine has
    begun anew. ``doubts`` keeps what was seen elsewhere than it must be.
    """

    def __init__(
        self,
        arm: StoppableArm,
        eyes: Eyes,
        controller: ReferenceLink,
        camera: CameraEyes,
        settings: ProgramSettings,
        dimensions: BoomDimensions,
        log: HealthyLog,
        hand_eye: GuidedCalibration | None = None,
    ) -> None:
        self.arm = CarryingArm(arm, eyes, camera)
        self.eyes = ReportingEyes(eyes, self._remember)
        self.controller = controller
        self.camera = camera
        self.settings = settings
        self.dimensions = dimensions
        self.log = log
        self.hand_eye = hand_eye
        self.calibration: LocalCalibration | None = None
        self.track: LocalTrack | None = None
        self.doubts = DoubtKeeper()
        self.positioning = settings.positioning
        self.metrics: Callable[[], dict[str, Any]] = dict
        self.incidents: Callable[[], Sequence[ServiceIncident]] = tuple
        self.links: tuple[DhLink, ...] = ()
        self.looks = 0
        self.times_anew = 0
        self.newest_look: JudgedLook | None = None

    @property
    def guided(self) -> GuidedCalibration:
        """The guided hand-eye session. Raises RequestRefused (``refused.hand_eye.none``) without one."""
        if self.hand_eye is None:
            raise RequestRefused("refused.hand_eye.none", "this rig has no guided hand-eye calibration")
        return self.hand_eye

    @property
    def latest_look(self) -> JudgedLook:
        """The latest look of any program. Raises RequestRefused (``refused.no_look_yet``)."""
        if self.newest_look is None:
            raise RequestRefused(
                "refused.no_look_yet", "nothing was looked at since service and machine started"
            )
        return self.newest_look

    def begin_anew(self) -> None:
        """Forget what holds for one run of the machine: local calibrations, the look, targets' places."""
        self.calibration = self.track = self.newest_look = None
        self.doubts = DoubtKeeper()
        self.camera.targets.lose()
        self.controller.home = None  # where it is heard next is where it stands first
        self.times_anew += 1
        lost = [kept.id for kept in self.camera.targets.list()]
        self.log.write("machine_begun_anew", "warning", targets_lost=lost)

    def doubt(self, found: Contradiction | None) -> None:
        """Keep what the end of a drive contradicts."""
        if found is not None:
            self.doubts.raised(found)
            self.log.write("doubt_raised", "warning", doubt=doubt_json(found))

    def trust(self, by: str) -> None:
        """Nothing is in doubt any longer: a ``calibration``, a ``look`` or a ``person`` says so."""
        if self.doubts.doubt is not None:
            self.log.write("doubt_ended", by=by)
        self.doubts.answered()

    def _remember(self, taken: Look) -> Look:
        before, aimed = self.doubts.doubt, self.camera.targets.aimed
        look = self.doubts.looked(taken, (self.arm.motions, None if aimed is None else aimed.id))
        if look.doubt is None and before is not None:
            self.log.write("doubt_ended", by="look")
        elif look.doubt is not None and look.doubt != before:
            self.log.write("doubt_raised", "warning", doubt=doubt_json(look.doubt))
        self.newest_look = JudgedLook(look, judge(look, self.positioning))
        self.looks += 1
        shown = look_json(self.newest_look)
        self.log.write("look", looked_ns=shown.pop("time_ns"), **shown)
        return look
