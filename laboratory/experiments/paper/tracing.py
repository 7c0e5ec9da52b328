"""A camera that watches every motion of a measurement, for the paper's curves over time."""

import io
from collections.abc import AsyncIterator, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any, NamedTuple

import numpy as np

from testbed.lockstep.world import VISION_CLOCK_NS, World
from vision_pc.core.calibration.line_equation import LineEquation
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.orientation import orientation_error
from vision_pc.core.ports import Arm, ArmView, Eyes, ReferenceStream, Watch
from vision_pc.core.se3 import Array
from vision_pc.core.types import Look, WatchSample


class Traced(NamedTuple):
    """What the range adjustment of a measurement found."""

    line: LineEquation | None = None
    match: LocalCalibration | None = None


class Input(NamedTuple):
    """A reference that was given at ``time_ns``: its corners (n, 3) in B."""

    time_ns: int
    corners: Array


class Tracer:
    """Notes what arm and eyes are asked and what the camera saw meanwhile."""

    def __init__(self) -> None:
        self.samples: list[WatchSample] = []
        self.path: tuple[WatchSample, ...] = ()
        self.inputs: list[Input] = []
        self.looks: list[Look] = []
        self.result: Traced | None = None

    def over(self, arm: Arm, eyes: Eyes) -> tuple[Arm, Eyes]:
        """Arm and eyes that do the same and tell this tracer."""
        traced = _TracedEyes(eyes, self)
        return _TracedArm(arm, traced, self), traced

    def as_npz(self, world: World) -> bytes:
        """Everything as arrays: times in s of the simulation, places in m, angles in degrees, NaN unseen."""
        nothing = np.full(3, np.nan)

        def error(sample: WatchSample) -> Array:
            if sample.X_CM is None or sample.X_CO is None:
                return nothing
            return sample.X_CO[:3, 3] - sample.X_CM[:3, 3]

        def turn(sample: Any) -> Array:
            return nothing if sample.X_CM is None or sample.X_CO is None else orientation_error(sample)

        held = [s for s in self.path if s.X_C0C is not None]
        arrays: dict[str, Any] = {
            "time_s": [_seconds(s.time_ns) for s in self.samples],
            "p_BT": [s.X_BT[:3, 3] for s in self.samples],
            "error_m": [error(s) for s in self.samples],
            "turn_deg": [np.degrees(turn(s)) for s in self.samples],
            "look_s": [_seconds(look.time_ns) for look in self.looks],
            "look_error_m": [look.X_CO[:3, 3] - look.X_CM[:3, 3] for look in self.looks],
            "look_turn_deg": [np.degrees(turn(look)) for look in self.looks],
            "input_s": [_seconds(given.time_ns) for given in self.inputs],
            "path_p_BT": [s.X_BT[:3, 3] for s in held or self.path],
            "path_p_C0C": [s.X_C0C[:3, 3] for s in held if s.X_C0C is not None],
            "true_s": [1e-9 * truth.time_ns for truth in world.truths[::5]],
            "true_p_WT": [truth.X_WT[:3, 3] for truth in world.truths[::5]],
        }
        for number, given in enumerate(self.inputs):
            arrays[f"corners_{number}"] = given.corners
        if self.result is not None and self.result.match is not None:
            arrays["R_BC"] = self.result.match.R_BC
        file = io.BytesIO()
        saved: dict[str, Any] = {name: np.asarray(value, dtype=float) for name, value in arrays.items()}
        np.savez_compressed(file, **saved)
        return file.getvalue()


def _seconds(vision_ns: int) -> float:
    return 1e-9 * (vision_ns - VISION_CLOCK_NS)


class _TracedEyes:
    """Implements ``Eyes``."""

    def __init__(self, eyes: Eyes, tracer: Tracer) -> None:
        self._eyes = eyes
        self._tracer = tracer

    async def look(self, frames: int | None = None) -> Look:
        look = await self._eyes.look(frames)
        self._tracer.looks.append(look)
        return look

    @asynccontextmanager
    async def watch(self, *, markers: bool, odometry: bool) -> AsyncIterator[Watch]:
        async with self._eyes.watch(markers=True, odometry=odometry) as watch:
            yield watch
        self._tracer.samples += watch.samples
        self._tracer.path = watch.samples


class _TracedArm:
    """Implements ``Arm``: a motion that no program watches is watched for the tracer."""

    def __init__(self, arm: Arm, eyes: _TracedEyes, tracer: Tracer) -> None:
        self._arm = arm
        self._eyes = eyes
        self._tracer = tracer

    async def view(self) -> ArmView:
        return await self._arm.view()

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        view = await self._arm.view()
        self._tracer.inputs.append(Input(view.time_ns, np.array([view.X_BT[:3, 3], X_BT_ref[:3, 3]])))
        path = self._tracer.path
        async with self._eyes.watch(markers=True, odometry=False):
            arrived = await self._arm.move_to(X_BT_ref, duration_s)
        self._tracer.path = path
        return arrived

    async def follow(
        self, waypoints: Sequence[Array], segment_s: float = 0.0, dwell_s: float = 0.0
    ) -> ArmView:
        view = await self._arm.view()
        corners = np.array([view.X_BT[:3, 3], *(X[:3, 3] for X in waypoints)])
        self._tracer.inputs.append(Input(view.time_ns, corners))
        return await self._arm.follow(waypoints, segment_s, dwell_s)

    def streaming(self) -> AbstractAsyncContextManager[ReferenceStream]:
        return self._arm.streaming()

    async def stop(self) -> None:
        await self._arm.stop()
