"""Eyes on a camera with pixels: its pictures for people and for calibrations, and targets clicked in them."""

from collections import deque
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from vision_pc.application.annotate import annotated, png
from vision_pc.application.camera_feed import CameraFeed
from vision_pc.application.eyes import FrameEyes
from vision_pc.application.ports import CameraStatus, Log, Runtime, Seen
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.application.targets.carrier import AimedSensor, TargetCarrier
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry.foreign_poses import PoseFeed
from vision_pc.core.ports import PairsAtRest
from vision_pc.core.se3 import Array
from vision_pc.core.targets.keeper import KeptTarget, TargetKeeper, refuse_moved
from vision_pc.core.targets.measuring import at_click, holes
from vision_pc.core.targets.sighting import Click
from vision_pc.core.targets.target import TargetObservation, TargetRefused
from vision_pc.core.types import FrameObservation, StereoPair

T = TypeVar("T")
_MOST_SHOWN = 32
_KEPT_NS = 3_000_000_000  # [D] how long a click may come after the picture that it is on
_ANSWERED_NS = 20_000_000_000  # who is asked for the place in the other eye has to find it there first
_COMPARED_NS = 300_000_000  # [E] after a click: what goes by at 1.5 cm/s, 1 m away, has moved by 2 px
_MOVED = 0.001  # m, rad: an arm that did so since a picture was taken has moved
_R_TM = np.diag([1.0, -1.0, -1.0])  # nominal axes of the tool's marker


class CameraEyes(FrameEyes[StereoPair]):
    """Eyes on a camera with pixels; they also hand its pictures to people and to calibrations.

    ``targets`` are those that were clicked. ``carries``: whether motions must be watched for them.
    """

    def __init__(
        self,
        frames: CameraFeed[StereoPair],
        states: ReferenceLink,
        config: VisionConfig,
        runtime: Runtime,
        log: Log,
        feed: PoseFeed | None = None,
    ) -> None:
        self.targets = TargetKeeper(config.targets)
        sensor = AimedSensor(config, self.targets, feed)
        carrier = TargetCarrier(self.targets, sensor, states)
        super().__init__(frames, sensor, states, config.look, runtime, log, carrier)
        self._aimed = sensor
        self._camera = sensor.camera
        self._tool_id = config.markers.tool.id
        self._shown: deque[StereoPair] = deque(maxlen=_MOST_SHOWN)
        self._in_click: StereoPair | None = None  # of the last click that wants its place in the other eye
        self._carrier = carrier

    def status(self) -> CameraStatus:
        """How the camera is doing."""
        return self._frames.status()

    @property
    def carries(self) -> bool:
        """Whether a motion must be watched, because targets are kept and nobody watches."""
        return self._carrier.carries

    async def pairs_at_rest(self, frames: int) -> PairsAtRest:
        """Fresh pairs with the arm at rest. Raises as ``look``, but measures nothing."""
        pairs = [pair async for pair in self._frames_at_rest(frames)]
        middle_ns = int(np.mean([pair.capture_ns for pair in pairs]))
        return PairsAtRest(tuple(pairs), await self._states.pose_at(middle_ns))

    async def aside(self, work: Callable[[], T]) -> T:
        """What ``work`` returns, computed where the eyes compute: the link is not held up."""
        return await self._runtime.worker.run(work)

    async def latest_png(self) -> bytes:
        """The newest picture with detections, PNG. Raises LinkLost when the camera never gave one."""
        await self.observe()
        assert self._latest is not None
        shown = self._latest
        self._show(shown[0])
        return await self.aside(lambda: png(annotated(*shown, self._camera)))

    async def observe(self) -> None:
        """Measure in the newest picture, if it was not. Raises LinkLost when the camera never gave one."""
        pair = self._frames.newest or await self._frames.frame_after(0)
        if self._latest is None or self._latest[0].capture_ns < pair.capture_ns:
            await self._observed(pair)

    def seen(self) -> Seen | None:
        """What was measured in a picture last, None before the first measurement."""
        return None if self._latest is None else Seen(self._latest[1], self._camera, self._tool_id)

    async def pair_after(self, capture_ns: int) -> StereoPair:
        """The first pair captured after ``capture_ns``, to be shown to people. Raises LinkLost."""
        pair = await self._frames.frame_after(capture_ns)
        self._show(pair)
        return pair

    async def target_at(self, click: Click, frame_id: int | None) -> KeptTarget:
        """Measure what a click means in a picture that was shown (None: in a fresh one), and keep it.

        Raises TargetRefused: ``target.frame_too_old`` for a picture that is no longer kept or was taken
        before the arm moved, ``target.moves`` for what is elsewhere in the newest picture, and as
        ``at_click``; RequestRefused (``refused.moving``), LinkLost.
        """
        pair = await self._clicked(frame_id, answers=click.other is not None)
        newest = await self._later(pair)
        X_BT = await self._at_rest_since(pair)
        self._in_click = None
        try:
            observation, found = await self.aside(lambda: self._measure_click(pair, click, newest))
        except TargetRefused as refused:
            self._in_click = pair if refused.candidates else None
            raise
        if self._latest is None:  # so that how far the tool has to go is told of the first click too
            self._latest = pair, observation
        X_CM = observation.X_CM
        X_BO = None
        if X_CM is not None:
            X_BO = X_BT @ se3.transform(_R_TM, np.zeros(3)) @ se3.inverse(X_CM) @ found.X_CO
        return self.targets.add(found, pair.frame_id, X_BT, X_BO)

    async def detected_holes(self, diameter_mm: float | None) -> tuple[int, list[TargetObservation]]:
        """The number of the newest picture and all holes in it. Raises LinkLost."""
        pair = self._frames.newest or await self._frames.frame_after(0)
        self._show(pair)
        before = None if self._latest is None else self._latest[1]
        found = await self.aside(
            lambda: holes(self._aimed.sighted(pair, self._aimed.plain(pair, before)), diameter_mm)
        )
        return pair.frame_id, found

    def _show(self, pair: StereoPair) -> None:
        if not self._shown or self._shown[-1].frame_id != pair.frame_id:
            self._shown.append(pair)

    async def _clicked(self, frame_id: int | None, answers: bool = False) -> StereoPair:
        """``answers``: it tells the place in the other eye too; the picture asked about is kept longer."""
        now_ns = self._runtime.clock.now_ns
        if frame_id is None:
            return await self._frames.frame_after(now_ns)
        clicked = self._in_click if answers else None
        for pair, kept_ns in [(clicked, _ANSWERED_NS), *((shown, _KEPT_NS) for shown in self._shown)]:
            same = pair is not None and pair.frame_id & 0xFFFFFFFF == frame_id & 0xFFFFFFFF
            if pair is not None and same and now_ns - pair.capture_ns <= kept_ns:
                return pair
        raise TargetRefused(
            "target.frame_too_old",
            f"target: picture {frame_id} is not among those shown in the last {1e-9 * _KEPT_NS:g} s",
        )

    async def _later(self, pair: StereoPair) -> StereoPair:
        """A picture so much later than ``pair`` that what moves is seen elsewhere in it."""
        newest = self._frames.newest or pair
        while newest.capture_ns < pair.capture_ns + _COMPARED_NS:
            newest = await self._frames.frame_after(newest.capture_ns)
        return newest

    async def _at_rest_since(self, pair: StereoPair) -> Array:
        self._refuse_moving()
        then, now = await self._states.pose_at(pair.capture_ns), self._carrier.X_BT
        moved = se3.local(then, now)
        if np.linalg.norm(moved[:3]) > _MOVED or np.linalg.norm(moved[3:]) > _MOVED:
            raise TargetRefused(
                "target.frame_too_old", f"target: the arm has moved since picture {pair.frame_id}"
            )
        return now

    def _measure_click(
        self, pair: StereoPair, click: Click, newest: StereoPair
    ) -> tuple[FrameObservation, TargetObservation]:
        before = None if self._latest is None else self._latest[1]
        observation = self._aimed.plain(pair, before)
        found = at_click(self._aimed.sighted(pair, observation), click)
        refuse_moved(pair.left, newest.left, click.pixel)
        return observation, found
