"""Our own coupler in a thread of its own, to be asked over a real socket."""

import asyncio
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from types import TracebackType
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


class Threaded(ABC):
    """Serves on ``port`` in a thread of its own until it is left."""

    def __init__(self) -> None:
        self.port = 0
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None

    async def _run(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        with socket.socket() as bound:
            bound.bind(("127.0.0.1", 0))
            self.port = bound.getsockname()[1]
            await self.serve(bound, self._stop)

    @abstractmethod
    async def serve(self, bound: socket.socket, stop: asyncio.Event) -> None:
        """Listen, call ``ready``, and return when ``stop`` is set."""

    def ready(self) -> None:
        """Clients may come."""
        self._ready.set()

    def __enter__(self) -> Self:
        self._thread.start()
        assert self._ready.wait(10.0)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._loop is not None
        assert self._stop is not None
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(10.0)


class ThreadedCoupler(Threaded):
    """Our own coupler on a plant that rests."""

    clock: ClassVar[ShiftedClock | None] = None

    def __init__(self) -> None:
        super().__init__()
        self.written: list[ValveImage] = []
        self._valves = ValveCommands(ValveDrive((0,) * 6, (0.0,) * 6), MOTION_WATCHDOG_NS)
        self.take(ValveImage(0, 0, (0.0,) * 6))  # loads what is compiled, before anybody waits for it
        self.sensors()
        self.written.clear()

    def make(self) -> Coupler:
        """The coupler to serve."""
        return Coupler(self.sensors, self.take, RELEASE_NS, self.clock_ns())

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

    async def serve(self, bound: socket.socket, stop: asyncio.Event) -> None:
        """Answer until ``stop``."""
        coupler = self.make()
        await coupler.start(bound)
        self.ready()
        await stop.wait()
        await coupler.stop()
