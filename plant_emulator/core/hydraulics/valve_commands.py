"""From valve images to spool targets: enable bit, watchdog, and delay of the drive electronics."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core.layout import N_ACTUATORS
from protocol.errors import ImageRefused
from protocol.process_image import CONTROL_ENABLE, CONTROL_RESET_WATCHDOG, ValveImage

NEVER_NS = 1 << 62
_SHUT = (0.0,) * N_ACTUATORS


class _Pending(NamedTuple):
    """A valve command on its way through the drive electronics."""

    due_ns: int
    valves: tuple[float, ...]


class ValveCommands:
    """What the valves are told. ``target`` (6,) in −1…1 is in force; ``tripped`` while the watchdog is.

    The watchdog trips when the controller's cycle counter stands still for longer than ``watchdog_ns``; until
    a first image it waits. Whoever owns the time calls ``settle`` when it has reached ``next_ns``.
    """

    def __init__(self, delay_ns: int, watchdog_ns: int) -> None:
        self.target: NDArray[np.float64] = np.zeros(N_ACTUATORS)
        self.tripped = False
        self._delay_ns = delay_ns
        self._watchdog_ns = watchdog_ns
        self._pending: list[_Pending] = []
        self._image: ValveImage | None = None
        self._fresh_ns = 0

    @property
    def enabled(self) -> bool:
        """Whether commands reach the valves."""
        return self._image is not None and bool(self._image.control & CONTROL_ENABLE) and not self.tripped

    @property
    def echo_cycle(self) -> int:
        """The cycle counter of the newest image; 0 before the first."""
        return 0 if self._image is None else self._image.controller_cycle

    def write(self, image: ValveImage, now_ns: int) -> None:
        """Take the controller's valve image at ``now_ns``.

        Raises ImageRefused when a valve command is not finite.
        """
        if not all(map(math.isfinite, image.valves)):
            raise ImageRefused("image.not_finite", f"valve commands {image.valves}: want finite numbers")
        before = self._image
        held = before.control if before is not None else 0
        if before is None or image.controller_cycle != before.controller_cycle:
            self._fresh_ns = now_ns
        if image.control & CONTROL_RESET_WATCHDOG and not held & CONTROL_RESET_WATCHDOG:
            self.tripped = False
            self._fresh_ns = now_ns
        self._image = image
        self._command(tuple(image.valves) if self.enabled else _SHUT, now_ns)

    def next_ns(self) -> int:
        """When something will change by itself: a command leaves the delay, or the watchdog trips."""
        return min(self._pending[0].due_ns if self._pending else NEVER_NS, self._deadline_ns())

    def settle(self, now_ns: int) -> None:
        """Let what is due by now happen: the watchdog, then commands that leave the delay."""
        if now_ns >= self._deadline_ns():
            self.tripped = True
            self._command(_SHUT, now_ns)
        while self._pending and self._pending[0].due_ns <= now_ns:
            self.target[:] = np.clip(self._pending.pop(0).valves, -1.0, 1.0)

    def _deadline_ns(self) -> int:
        if self._image is None or self.tripped:
            return NEVER_NS
        return self._fresh_ns + self._watchdog_ns + 1

    def _command(self, valves: tuple[float, ...], now_ns: int) -> None:
        due = now_ns + self._delay_ns
        self._pending = [p for p in self._pending if p.due_ns < due] + [_Pending(due, valves)]
