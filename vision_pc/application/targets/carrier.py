"""What goes along with every look and watch of the eyes, so that clicked targets stay known."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from vision_pc.application.ports import StateSource
from vision_pc.application.targets.aimed_sensor import AimedSensor
from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.targets.keeper import TargetKeeper
from vision_pc.core.types import Look, WatchSample


class TargetCarrier:
    """Implements ``vision_pc.application.ports.Attendant`` for the targets of ``targets``."""

    def __init__(self, targets: TargetKeeper, sensor: AimedSensor, states: StateSource) -> None:
        self._targets = targets
        self._sensor = sensor
        self._states = states
        self._watching = False

    @property
    def carries(self) -> bool:
        """Whether a motion must be watched, because targets are kept and nobody watches."""
        return bool(self._targets.list()) and not self._watching

    @property
    def object_wanted(self) -> bool:
        """Whether a watch that never sees the object's markers has failed: not for a target."""
        return self._targets.aimed is None

    @property
    def X_BT(self) -> Array:
        """Where the controller has the tool now. Raises LinkLost."""
        return se3.from_pose(self._states.state.X_BT)

    @contextmanager
    def looking(self) -> Iterator[Callable[[Look], None]]:
        """A look: a target that is aimed at is measured, or stands where it was carried.

        Raises RequestRefused (``refused.target_lost``) where nobody knows that.
        """
        if self._targets.aimed is None:
            yield _forgotten
            return
        self._targets.refuse_lost(self.X_BT)
        self._sensor.resting, self._sensor.measured = True, 0
        try:
            yield self._looked
        finally:
            self._sensor.resting = False

    @contextmanager
    def watching(self) -> Iterator[Callable[[tuple[WatchSample, ...]], None]]:
        """A watch: targets are carried by its last odometry; a watch that fails loses them."""
        if not self._targets.list():
            yield _forgotten
            return
        X_BT, ends = self.X_BT, list[Array | None]()
        self._watching = True
        try:
            yield lambda samples: ends.append(samples[-1].X_C0C)
        finally:
            self._watching = False
            self._targets.carry(ends[0] if ends else None, X_BT, self.X_BT)

    def _looked(self, look: Look) -> None:
        measured = 2 * self._sensor.measured > look.frames
        self._targets.looked(look.X_CO, look.cov_CO, look.X_BT, measured)


def _forgotten(_seen: Look | tuple[WatchSample, ...]) -> None:
    """Nobody wants to know."""
