"""From valve images to spool targets: enable bit, watchdog, delay of the drive electronics, hysteresis."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.core.layout import N_ACTUATORS
from protocol.errors import ImageRefused
from protocol.process_image import CONTROL_ENABLE, CONTROL_RESET_WATCHDOG, ValveImage


@allocation_free
def opening(travel: float, overlap: float, slope: float) -> float:
    """Effective opening 0…1 of an edge at spool ``travel`` 0…1: zero up to the overlap, 1 at full travel.

    ``slope``: of this curve where the edge opens, over its mean; 1 makes it straight, less progressive.
    """
    size = travel - overlap
    if size <= 0.0:
        return 0.0
    share = size / (1.0 - overlap)
    return share * (slope + (1.0 - slope) * share)


@allocation_free
def orifice_flow(gain: float, drop: float, regularisation: float) -> float:
    """Turbulent flow (m³/s) through an edge of ``gain`` (m³/s/√Pa) at pressure ``drop`` (Pa).

    Odd and smooth: K Δp / (Δp² + δ²)^¼, which is K √Δp for Δp ≫ δ and laminar at zero.
    """
    return gain * drop / math.sqrt(math.sqrt(drop * drop + regularisation * regularisation))


@allocation_free
def compensated_drop(drop: float, compensated: float) -> float:
    """What is left (Pa) across a metering edge of ``drop`` (Pa) from pump to load, by its compensator.

    The compensator, a valve in series before the edge, keeps ``compensated`` (Pa) across it as long as there
    is that much: far above, the flow does not depend on the load; below, the valve is wide open and the edge
    alone counts. It also is a check valve: no oil goes back.
    """
    if drop <= 0.0:
        return 0.0
    ratio = drop / compensated
    ratio *= ratio
    return drop / math.sqrt(math.sqrt(1.0 + ratio * ratio))


@allocation_free
def spool_acceleration(command: float, spool: float, rate: float, natural: float, damping: float) -> float:
    """Second-order spool, ẍ = ω²(u − x) − 2ζω ẋ (1/s²)."""
    return natural * natural * (command - spool) - 2.0 * damping * natural * rate


@allocation_free
def _ramped(previous: float, target: float, limit: float, h: float) -> tuple[float, float]:
    """The command after ``h`` seconds at ``limit`` (1/s) towards ``target``, and its mean until then."""
    way = target - previous
    if abs(way) >= limit * h:
        ramp = math.copysign(limit * h, way)
        return previous + ramp, previous + 0.5 * ramp
    return target, target - 0.5 * way * abs(way) / (limit * h)


@allocation_free
def slew_limited(previous: float, target: float, out: float, back: float, h: float) -> tuple[float, float]:
    """The spool's command after ``h`` seconds on its way to ``target``, and its mean over that time.

    It ramps at ``out`` (1/s) away from the centre, at ``back`` towards it. A ramp may end or pass the centre
    inside the step: the mean carries its exact impulse, so that the spool's response does not depend on the
    step size to first order.
    """
    if out == back:
        return _ramped(previous, target, out, h)
    if previous * target >= 0.0:
        return _ramped(previous, target, out if abs(target) > abs(previous) else back, h)
    until_centre = abs(previous) / back
    if until_centre >= h:
        return _ramped(previous, target, back, h)
    left = h - until_centre
    reached, mean = _ramped(0.0, target, out, left)
    return reached, (0.5 * previous * until_centre + mean * left) / h


@allocation_free
def held_gain(release: float, hold: float) -> float:
    """Gain of a releasing edge in series with a counterbalance valve of gain ``hold`` as it stands open.

    Two turbulent edges in series pass what one of gain K1 K2 / √(K1² + K2²) would; a closed one holds the
    load.
    """
    if hold <= 0.0 or release <= 0.0:
        return 0.0
    return release * hold / math.sqrt(release * release + hold * hold)


NEVER_NS = 1 << 62
_SHUT = (0.0,) * N_ACTUATORS


class ValveDrive(NamedTuple):
    """What lies between commands and spools, per valve: ``delay_ns``, half the width of the hysteresis."""

    delay_ns: tuple[int, ...]
    half_hysteresis: tuple[float, ...]


class ValveTargets(NamedTuple):
    """Where the six valves are sent, (6,) each, −1…1.

    ``commanded``: what is in force. ``spool``: where the spools go, dragged along by what is told with the
    hysteresis as its play (``half_hysteresis`` each way). ``drive``: how far the slew limit has let them.
    ``senses``: −1 where a valve goes the other way.
    """

    commanded: NDArray[np.float64]
    spool: NDArray[np.float64]
    drive: NDArray[np.float64]
    half_hysteresis: NDArray[np.float64]
    senses: NDArray[np.float64]


class Leaving(NamedTuple):
    """A valve's command that leaves the drive electronics at ``due_ns``."""

    due_ns: int
    valve: int
    command: float


@allocation_free
def take(valves: ValveTargets, valve: int, command: float) -> None:
    """Let ``command`` be in force for one valve."""
    commanded, play = min(max(valves.senses[valve] * command, -1.0), 1.0), valves.half_hysteresis[valve]
    valves.commanded[valve] = commanded
    valves.spool[valve] = min(max(valves.spool[valve], commanded - play), commanded + play)


class ValveCommands:
    """What the valves are told. ``targets`` are in force; ``tripped`` while the watchdog is.

    The watchdog trips when the controller's cycle counter stands still for longer than ``watchdog_ns``; until
    a first image it waits. Whoever owns the time calls ``settle`` when it has reached ``deadline_ns``, and
    lets what ``leaving`` gives act in time.
    """

    def __init__(self, drive: ValveDrive, watchdog_ns: int) -> None:
        shut, half = np.zeros(N_ACTUATORS), np.array(drive.half_hysteresis)
        self.targets = ValveTargets(shut.copy(), shut.copy(), shut.copy(), half, np.ones(N_ACTUATORS))
        self.tripped = False
        self._delays_ns = drive.delay_ns
        self._watchdog_ns = watchdog_ns
        self._pending: dict[tuple[int, int], float] = {}  # when it is due and for which valve → command
        self._next_ns = NEVER_NS  # when the first of them is
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
        self.targets.senses[:] = 1.0
        self.targets.senses[list(valves)] = -1.0

    def deadline_ns(self) -> int:
        """When the watchdog trips unless an image comes."""
        if self._image is None or self.tripped:
            return NEVER_NS
        return self._fresh_ns + self._watchdog_ns + 1

    def settle(self, now_ns: int) -> None:
        """Let what is due by now happen: the watchdog, then commands that leave the delay."""
        if now_ns >= self.deadline_ns():
            self.tripped = True
            self._command(_SHUT, now_ns)
        for _, valve, command in self.leaving(now_ns):
            take(self.targets, valve, command)

    def leaving(self, until_ns: int) -> list[Leaving]:
        """What leaves the drive electronics by ``until_ns``, in this order; it is no longer kept here."""
        if until_ns < self._next_ns:
            return []
        due = sorted([key for key in self._pending if key[0] <= until_ns])
        leaving = [Leaving(*key, self._pending.pop(key)) for key in due]
        self._next_ns = min([due_ns for due_ns, _ in self._pending], default=NEVER_NS)
        return leaving

    def _command(self, valves: tuple[float, ...], now_ns: int) -> None:
        for valve, command in enumerate(valves):
            self._pending[now_ns + self._delays_ns[valve], valve] = command
        self._next_ns = min(self._next_ns, now_ns + min(self._delays_ns))
