"""From valve images to spool targets: enable bit, watchdog, delay of the drive electronics, hysteresis."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core.layout import N_ACTUATORS
from protocol.errors import ImageRefused
from protocol.process_image import CONTROL_ENABLE, CONTROL_RESET_WATCHDOG, ValveImage

NEVER_NS = 1 << 62
_SHUT = (0.0,) * N_ACTUATORS


class ValveDrive(NamedTuple):
    """What lies between commands and spools, per valve: ``delay_ns``, half the width of the hysteresis."""

    delay_ns: tuple[int, ...]
    half_hysteresis: tuple[float, ...]


class _Pending(NamedTuple):
    """Commands of the valves ``who`` on their way through the drive electronics."""

    due_ns: int
    who: list[int]
    valves: NDArray[np.float64]  # (len(who),)


class ValveCommands:
    """What the valves are told. ``target`` (6,) in −1…1 is in force; ``tripped`` while the watchdog is.

    ``spool_target`` (6,) is where the spools go: the target drags it along with the hysteresis as its play.
    The watchdog trips when the controller's cycle counter stands still for longer than ``watchdog_ns``; until
    a first image it waits. Whoever owns the time calls ``settle`` when it has reached ``next_ns``.
    """

    def __init__(self, drive: ValveDrive, watchdog_ns: int) -> None:
        self.target: NDArray[np.float64] = np.zeros(N_ACTUATORS)
        self.spool_target: NDArray[np.float64] = np.zeros(N_ACTUATORS)
        self.tripped = False
        self._half_play = np.array(drive.half_hysteresis)
        self._senses = np.ones(N_ACTUATORS)
        self._delays = {
            delay: [i for i, own in enumerate(drive.delay_ns) if own == delay]
            for delay in sorted(set(drive.delay_ns))
        }
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

    def swap(self, valves: Sequence[int]) -> None:
        """Let ``valves``, and no others, go against what leaves the drive electronics from now on."""
        self._senses[:] = 1.0
        self._senses[list(valves)] = -1.0

    def next_ns(self) -> int:
        """When something will change by itself: a command leaves the delay, or the watchdog trips."""
        return min(self._pending[0].due_ns if self._pending else NEVER_NS, self._deadline_ns())

    def settle(self, now_ns: int) -> None:
        """Let what is due by now happen: the watchdog, then commands that leave the delay."""
        if now_ns >= self._deadline_ns():
            self.tripped = True
            self._command(_SHUT, now_ns)
        while self._pending and self._pending[0].due_ns <= now_ns:
            _, who, valves = self._pending.pop(0)
            told, play = np.clip(self._senses[who] * valves, -1.0, 1.0), self._half_play[who]
            self.target[who] = told
            self.spool_target[who] = np.clip(self.spool_target[who], told - play, told + play)

    def _deadline_ns(self) -> int:
        if self._image is None or self.tripped:
            return NEVER_NS
        return self._fresh_ns + self._watchdog_ns + 1

    def _command(self, valves: tuple[float, ...], now_ns: int) -> None:
        told = np.array(valves)
        for delay, who in self._delays.items():
            due = now_ns + delay
            kept = [p for p in self._pending if p.who is not who or p.due_ns < due]
            self._pending = sorted([*kept, _Pending(due, who, told[who])], key=lambda p: p.due_ns)
