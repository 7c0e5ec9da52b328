"""The whole machine in one simulated time, in this process: ROS follows its ``/clock``, at any pace."""

import asyncio
import contextlib
import time
from collections.abc import Callable
from pathlib import Path

from testbed.lockstep.clock import RunLog
from testbed.lockstep.world import VISION_CLOCK_NS, World
from testbed.scenarios.scenario import Overrides, load_settings
from vision_pc.application.reference_link import ReferenceLink

SEED = 1
OFFSET_NS = -VISION_CLOCK_NS  # ROS time is the simulated time, from 0 on, minus the time on vision's clock
CLOCK_NS = 10_000_000  # [D] between two messages of /clock
_BEHIND_S = 1.0  # [D] a machine that is so late does not catch up: it would rush
_PAUSED_S = 1.0  # between two messages of /clock while it stands: for nodes that come then


class SimulatedMachine:
    """Emulator, controller and both ends of the reference link in lockstep.

    Implements ``Clock`` of the vision PC's ports for programs of one event loop: whoever waits looks again
    after each cycle, before the next one.
    """

    def __init__(self, config_dir: Path, overrides: Overrides) -> None:
        """Raises ConfigurationError."""
        self.settings = load_settings(config_dir, overrides)
        self._world = World(self.settings, SEED, RunLog())
        self._world.clock = self  # type: ignore[assignment]
        self._world.open_link(nonce=SEED)
        self._news = asyncio.Event()
        self._going = asyncio.Event()
        self._going.set()

    @property
    def link(self) -> ReferenceLink:
        """Vision's end of the link."""
        return self._world.link

    @property
    def now_ns(self) -> int:
        """The time on vision's clock."""
        return self._world.vision_ns

    @property
    def time_ns(self) -> int:
        """The simulated time."""
        return self._world.time_ns

    def wake(self) -> None:
        """Have everybody who waits look again."""
        self._news.set()
        self._news = asyncio.Event()

    async def until(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for ``happened()``. Return False when ``timeout_s`` of simulated time have passed first."""
        until_ns = self.now_ns + round(1e9 * timeout_s)
        while not happened():
            if self.now_ns >= until_ns:
                return False
            await self._news.wait()
        return True

    def pause(self, paused: bool) -> None:
        """Let simulated time stand, or go on."""
        (self._going.clear if paused else self._going.set)()

    async def run(self, pace: float, tick: Callable[[int], None]) -> None:
        """Let time pass ``pace`` times as fast as real time, 0: as fast as it is computed, until cancelled.

        ``tick`` is given the simulated time (ns) every ``CLOCK_NS``, and once a second while it stands.
        """
        start_s, start_ns = time.monotonic(), self.time_ns
        while True:
            while not self._going.is_set():
                tick(self.time_ns)
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_PAUSED_S):
                        await self._going.wait()
                start_s, start_ns = time.monotonic(), self.time_ns
            self._step()
            if self.time_ns % CLOCK_NS == 0:
                tick(self.time_ns)
            early_s = 0.0
            if pace > 0.0:
                early_s = start_s + 1e-9 * (self.time_ns - start_ns) / pace - time.monotonic()
            if early_s < -_BEHIND_S:
                start_s, start_ns = time.monotonic(), self.time_ns
            await asyncio.sleep(max(early_s, 0.0))

    def _step(self) -> None:
        self._world.step()
        self._world.truths.clear()  # nobody asks for what was
        del self._world.states[:-1]
        self.wake()
