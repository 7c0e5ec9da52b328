"""What a guided session sees: the marker and the cabinet, from where the arm stands once it has settled."""

from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np

from protocol.errors import MeasurementFailed, RequestRefused
from protocol.reference_messages import State
from vision_pc.application.hand_eye.steps import load_drawing
from vision_pc.application.ports import StoppableArm
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.config.vision import VisionConfig
from vision_pc.core.hand_eye.guided import target
from vision_pc.core.hand_eye.guided.cabinet import CabinetLocator, Located
from vision_pc.core.hand_eye.guided.session import Session
from vision_pc.core.hand_eye.guided.target import TargetLook
from vision_pc.core.perception.intrinsics import calibration, with_offset
from vision_pc.core.perception.look import observe
from vision_pc.core.ports import Arm, ArmView, Photographer
from vision_pc.core.se3 import Array
from vision_pc.core.types import FrameObservation, StereoPair

_IMPOSSIBLE = {
    f"refused.{reason}"
    for reason in (
        "outside_workspace", "joint_limit", "unreachable", "singular", "too_fast", "too_far",
        "fault_joint_limit", "fault_workspace_limit", "fault_following_error",
    )
}  # fmt: skip


def impossible(error: RequestRefused) -> bool:
    """Whether the pose is not to be tried again: it was refused for its way, or the way ended in a fault."""
    return error.cause in _IMPOSSIBLE


def ended_in_fault(error: RequestRefused) -> bool:
    """Whether the arm has come to rest by a fault, and moves again only after RESET and ENABLE."""
    return error.cause.startswith("refused.fault_")


async def back_to_start(arm: Arm, session: Session) -> ArmView:
    """The view at the session's starting pose: straight there, or over its samples, the newest first.

    What led to a sample leads back from it, where the straight way would turn the wrist through its limits.
    Raises RequestRefused with what the controller said last.
    """
    start = session.around.X_BT_start
    for sample in (None, *reversed(session.samples)):
        try:
            if sample is not None:
                await arm.move_to(sample.X_BT)
            return await arm.move_to(start)
        except RequestRefused as error:
            if not impossible(error) or ended_in_fault(error):
                raise
            refusal = error
    raise refusal


T = TypeVar("T")


class Pictures(Photographer, Protocol):
    """The camera, and a place to compute that does not hold up the link."""

    async def aside(self, work: Callable[[], T]) -> T: ...


class States(Protocol):
    """The controller's states as they come."""

    async def next_state(self) -> State: ...


class HandEyeSight:
    """The camera of one rig, and what it remembers from picture to picture."""

    def __init__(self, arm: StoppableArm, pictures: Pictures, states: States, config: VisionConfig) -> None:
        self._arm = arm
        self._pictures = pictures
        self._states = states
        self._config = config
        self.camera = calibration(config.camera)
        self._last: FrameObservation | None = None
        self._offset: FrameObservation | None = None
        self._locator: CabinetLocator | None = None

    async def marker(self, settings: GuidedSettings) -> tuple[TargetLook, ArmView, float]:
        """The marker, the arm there, and by how many mrad an encoder moved meanwhile.

        Raises MeasurementFailed (``measurement.hand_eye.not_settled``, and what ``look_at_target`` raises).
        """
        before = await self._settled_view(settings)
        pictures = await self._pictures.pairs_at_rest(settings.frames)
        after = await self._arm.view()
        moved = 1e3 * float(np.abs(after.q_meas - before.q_meas).max())
        if moved > settings.moved_mrad or before.motion_id != after.motion_id:
            raise MeasurementFailed(
                "measurement.hand_eye.not_settled",
                f"the arm moved by {moved:.2f} mrad while the sample was taken, "
                f"limit {settings.moved_mrad:g} mrad",
            )
        known = target.target_settings(self._config.markers, settings)
        seen = await self._pictures.aside(
            lambda: target.look_at_target(
                pictures.pairs,
                self.camera,
                known,
                self._config.look,
                settings,
                self._last,
                frozenset(self._config.markers.sizes),
            )
        )
        self._last = seen.last
        return seen, after._replace(X_BT=pictures.X_BT), moved

    async def cabinet(self, settings: GuidedSettings) -> tuple[Array, tuple[Located, ...]]:
        """The hand X_BT (4, 4), and the cabinet's targets in the camera.

        Raises RequestRefused (``refused.hand_eye.no_drawing``), MeasurementFailed as
        ``CabinetLocator.locate``.
        """
        if self._locator is None:
            self._locator = CabinetLocator(load_drawing(self._config.cabinet))
        locator = self._locator
        await self._settled_view(settings)
        pictures = await self._pictures.pairs_at_rest(1)
        places = await self._pictures.aside(lambda: self._targets(pictures.pairs[0], locator))
        return pictures.X_BT, places

    def forget(self) -> None:
        """Forget the last marker: the next one is looked for in the whole picture."""
        self._last = None

    def _targets(self, pair: StereoPair, locator: CabinetLocator) -> tuple[Located, ...]:
        self._offset = observe(pair, self.camera, self._config.markers, self._offset)
        offset = self._offset.offset
        camera = self.camera if offset is None else with_offset(self.camera, offset.x_px, offset.y_px)
        return locator.locate(pair, camera)

    async def _settled_view(self, settings: GuidedSettings) -> ArmView:
        """The view once the controller's flag says settled, or the time for it has passed."""
        view = await self._arm.view()
        began_ns = view.time_ns
        while not view.settled and view.time_ns - began_ns < 1e9 * settings.settle_timeout_s:
            await self._states.next_state()
            view = await self._arm.view()
        return view
