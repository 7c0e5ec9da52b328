"""Our own coupler in a thread of its own, to be asked over a real socket."""

import asyncio
import socket
import threading
import time
from collections.abc import Callable
from typing import ClassVar, Self

from plant_emulator.core.hydraulics.valve_commands import ValveCommands, ValveDrive
from plant_emulator.shell.coupler import Coupler
from protocol.process_image import STATUS_WATCHDOG_TRIPPED, SensorImage, ValveImage, encode_sensors

RELEASE_NS = 1_000_000_000
MOTION_WATCHDOG_NS = 100_000_000
PLANT_CYCLE_NS = 5_000_000
_SETTLES_S = 0.005


class ShiftedClock:
    """The machine's clock, but waiting moves it instead of taking time."""

    def __init__(self) -> None:
        self._shift_ns = 0

    def monotonic_ns(self) -> int:
        """The time, ns."""
        return time.monotonic_ns() + self._shift_ns

    def monotonic(self) -> float:
        """The time, s."""
        return self.monotonic_ns() * 1e-9

    def sleep(self, seconds: float) -> None:
        """Move the clock by ``seconds``; what is under way on a socket gets 5 ms to arrive."""
        time.sleep(min(seconds, _SETTLES_S))
        self._shift_ns += round(max(seconds - _SETTLES_S, 0.0) * 1e9)


class ThreadedCoupler:
    """Our own coupler on a plant that rests; serves on ``port`` in a thread of its own until it is left."""

    clock: ClassVar[ShiftedClock | None] = None

    def __init__(self) -> None:
        self.port = 0
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()))
        self.written: list[ValveImage] = []
        self._valves = ValveCommands(ValveDrive((0,) * 6, (0.0,) * 6), MOTION_WATCHDOG_NS)
        self.take(ValveImage(0, 0, (0.0,) * 6))  # loads what is compiled, before anybody waits for it
        self.sensors()
        self.written.clear()

    def take(self, image: ValveImage) -> None:
        """A valve image acts."""
        self.written.append(image)
        now_ns = self.clock_ns()()
        self._valves.settle(now_ns)
        self._valves.write(image, now_ns)

    def clock_ns(self) -> Callable[[], int]:
        """The coupler's clock."""
        return self.clock.monotonic_ns if self.clock else time.monotonic_ns

    def sensors(self) -> list[int]:
        """The input image of a plant that rests."""
        now_ns = self.clock_ns()()
        self._valves.settle(now_ns)
        status = 0b0001 | (STATUS_WATCHDOG_TRIPPED if self._valves.tripped else 0)
        counts, pressures = (1, 2, 3, 4, 5, 6), ((1.0, 2.0),) * 6
        cycle = now_ns // PLANT_CYCLE_NS
        return encode_sensors(
            SensorImage(cycle, self._valves.echo_cycle, status, counts, pressures, 190.0, 10.0, 40.0)
        )

    async def _serve(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        coupler = Coupler(self.sensors, self.take, RELEASE_NS, self.clock_ns())
        with socket.socket() as bound:
            bound.bind(("127.0.0.1", 0))
            self.port = bound.getsockname()[1]
            await coupler.start(bound)
            self._ready.set()
            await self._stop.wait()
            await coupler.stop()

    def __enter__(self) -> Self:
        self._thread.start()
        assert self._ready.wait(10.0)
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(10.0)
