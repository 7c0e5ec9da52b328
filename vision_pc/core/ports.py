"""The two small interfaces that calibration programs are written over: an arm and eyes.

The real rig implements them over sockets and cameras, the lockstep rig by stepping the cores.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager
from typing import NamedTuple, Protocol

import numpy as np

from protocol.faults import FaultCode, GroupState, Severity
from vision_pc.core.se3 import Array
from vision_pc.core.types import Look, StereoPair, WatchHealth, WatchSample

Report = Callable[[float, str], None]
"""Called by programs as ``report(progress, note)`` with progress 0…1."""


NO_UNREST = np.zeros(6)
NO_UNREST.setflags(write=False)


class ArmView(NamedTuple):
    """The controller's own view of the arm at one instant; ``time_ns`` on the vision PC's clock.

    ``X_BT`` is the rigid model at the encoders, ``X_BT_cmd`` the desired pose; ``settled`` is the
    controller's own judgement. ``unrest`` (6,) rad: how far each encoder went to and fro before the arm,
    never settled, was taken for resting; zeros where it settled, or where nobody waited for it.
    """

    time_ns: int
    group_state: GroupState
    fault: FaultCode
    severity: Severity
    motion_id: int
    motion_done: bool
    settled: bool
    q_meas: Array
    q_cmd: Array
    X_BT: Array
    X_BT_cmd: Array
    unrest: Array = NO_UNREST


class ReferenceStream(Protocol):
    """An open stream of references; the arm follows the newest with bounded velocity, acceleration and jerk.

    The controller wants a fresh reference before its silence limit (100 ms by default): a late one makes it
    centre the valves and latch REFERENCE_STALE. Nothing resumes by itself: RESET, ENABLE, a new stream.
    """

    async def send(
        self, X_BT_ref: Array, measured_ns: int | None = None, twist_ref: Array | None = None
    ) -> None:
        """Send one reference, once. Does not wait for the controller.

        ``X_BT_ref`` (4, 4) within the controller's distance from the pose that it commands at present.
        ``measured_ns``: the instant of the picture that the reference rests on, on the vision PC's clock
        (None: now); the controller refuses what is too old. ``twist_ref`` (6,): the reference's own velocity
        and angular velocity in B (m/s, rad/s) when it is known to move, which takes the lag off; None: rest.

        Raises RequestRefused with the reason when the controller has refused an earlier reference or has
        ended the stream, and LinkLost.
        """
        ...

    async def view(self) -> ArmView:
        """The newest view, without waiting for it. Raises as ``send`` does."""
        ...


class Arm(Protocol):
    """Motion through the reference link. Every motion returns at rest, or raises.

    Raises RequestRefused (the controller's reason, the arm stopped), LinkLost, or MotionUnsettled
    (``motion.not_settled``) when the motion is done but the arm swings on: it still holds its last reference.
    """

    async def view(self) -> ArmView:
        """The newest view."""
        ...

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        """The view after the point-to-point motion has settled; ``duration_s`` 0: by its limits."""
        ...

    async def follow(
        self, waypoints: Sequence[Array], segment_s: float = 0.0, dwell_s: float = 0.0
    ) -> ArmView:
        """The view after the path through ``waypoints`` (1…24, at rest at each) has settled."""
        ...

    def streaming(self) -> AbstractAsyncContextManager[ReferenceStream]:
        """A context in which references are streamed; the arm must stand enabled and at rest to enter it.

        Leaving it ends the stream: the arm goes on to the last accepted reference, and the exit returns once
        it has settled there. An exception inside stops the arm instead, and is passed on.

        Raises RequestRefused (``refused.not_negotiated`` when the controller streams none) or LinkLost.
        """
        ...

    async def stop(self) -> None:
        """Stop the arm. Returns when the controller has accepted the stop."""
        ...


class PairsAtRest(NamedTuple):
    """Stereo pairs taken with the arm at rest, and X_BT at their mean capture time."""

    pairs: tuple[StereoPair, ...]
    X_BT: Array


class Watch(Protocol):
    """Samples along a motion, gathered in the background between entering and leaving ``Eyes.watch``."""

    @property
    def samples(self) -> tuple[WatchSample, ...]:
        """One sample for every processed pair, in time order; complete after the exit."""
        ...

    @property
    def health(self) -> WatchHealth:
        """What was missed; complete after the exit."""
        ...

    async def after(self, count: int, timeout_s: float) -> WatchSample | None:
        """The newest sample once there are more than ``count``, None when ``timeout_s`` have passed first."""
        ...


class Eyes(Protocol):
    """Measurements through the stereo camera."""

    async def look(self, frames: int | None = None) -> Look:
        """A look over ``frames`` fresh pairs (None: as configured) with the arm at rest.

        Raises MeasurementFailed when tool or object is seen in too few of them, RequestRefused while the arm
        moves, LinkLost when the camera is silent or frozen.
        """
        ...

    def watch(self, *, markers: bool, odometry: bool) -> AbstractAsyncContextManager[Watch]:
        """A context that samples every pair until its exit. The first camera frame of a watch is its C0.

        Raises MeasurementFailed on exit when nothing wanted was measured.
        """
        ...
