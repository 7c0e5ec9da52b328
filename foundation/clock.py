"""The time of this process: the machine's monotonic clock, or that of the plant, which it follows.

A process that follows has no timer of its own for what concerns the machine: what is due at a time is done
when the plant's tick has passed it, never by the wall. The plant goes on when every part has answered, and a
part answers when it has nothing left to do; so a slow machine is slow, and nothing comes late.
"""

import asyncio
import contextlib
import functools
import heapq
import itertools
import os
import selectors
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from typing import Any, NamedTuple, Protocol, TypeVar

from foundation.command_options import host_and_port
from protocol.errors import LinkLost
from protocol.plant_clock import IN_VAIN, PICTURE, SENT, START_NS, ClockMessage, TickKind, decode, encode

CLOCK, PACE = "LONGREACH_CLOCK", "LONGREACH_PACE"
"""Variables of the environment: HOST:PORT of the plant's clock, and how many times as fast as real time it
goes at most, or ``max``. Without the first every service runs by the wall."""
UNANSWERED_S = 2.0  # of wall time, until a part that does not answer a tick is named
_AGAIN_S = 0.2
_NEVER_NS = (1 << 63) - 1
_ROUNDED_S = 0.001  # uvloop's timers count milliseconds
PLANT = "plant_emulator"

Call = Callable[[], None]
T = TypeVar("T")


class Cancellable(Protocol):
    """What is to be called later."""

    def cancel(self) -> None: ...


class WaitedFor(NamedTuple):
    """Who is waited for, and for how long by the wall; the time of all stands until it answers."""

    waits_for: str
    seconds: float


class WallClock:
    """The machine's monotonic clock."""

    pace = 1.0
    sent = False
    standing: WaitedFor | None = None

    @property
    def now_ns(self) -> int:
        """The time."""
        return time.monotonic_ns()

    def call_at(self, when_ns: int, call: Call) -> Cancellable:
        """Have ``call`` called in the running loop once it is ``when_ns``, never before."""
        delay_s = max(1e-9 * (when_ns - self.now_ns) + _ROUNDED_S, 0.0)
        return asyncio.get_running_loop().call_later(delay_s, call)

    def holding(self) -> AbstractContextManager[None]:
        """A block of its own."""
        return contextlib.nullcontext()

    async def computed(self, thread: Executor, work: Callable[[], T], _takes_ns: int) -> T:
        """What ``work`` in a thread comes to, when it has."""
        return await asyncio.get_running_loop().run_in_executor(thread, work)

    def leave(self) -> None:
        """Go on by the wall, as ever."""


class GivenClock(WallClock):
    """The clock of who gives the time: it sets ``given_ns``."""

    def __init__(self) -> None:
        self.given_ns = START_NS

    @property
    def now_ns(self) -> int:
        """The time that was given last."""
        return self.given_ns


class _Timer:
    """What is to be called at a time."""

    def __init__(self, call: Call) -> None:
        self.call: Call | None = call

    def cancel(self) -> None:
        self.call = None


class PlantClock(asyncio.Protocol):
    """Follows the plant's clock, in an ``IdleLoop`` of its own.

    ``offset_ns``: this clock minus that of the plant. ``pictures``: how many the plant has announced.
    ``ready_to_answer``: all that must be true before a tick is answered, beside there being nothing to do.
    ``passes``: while it returns False the tick is held on purpose. ``in_vain`` is called where what was asked
    of the plant stays unanswered, ``on_time`` at every tick. ``sent``: to be set by who has sent something to
    another part since the last tick.
    """

    def __init__(self, where: tuple[str, int], name: str) -> None:
        self.offset_ns = 0
        self.pictures = 0
        self.pace = 0.0
        self.ready_to_answer: list[Callable[[], bool]] = []
        self.on_time: list[Call] = []
        self.passes: Callable[[], bool] = lambda: True
        self.in_vain: Call = lambda: None
        self._where, self._name, self._period_ns = where, name, 0
        self._now_ns = START_NS
        self._timers: list[tuple[int, int, _Timer]] = []
        self._order = itertools.count()
        self._holds = 0
        self._tick: ClockMessage | None = None
        self._acting = self._held = self._ready = self._left = self.sent = False
        self._transport: asyncio.WriteTransport | None = None
        self._buffer = b""
        self._stands: ClockMessage | None = None
        self._newest_s = time.monotonic()
        self._known, self._news = asyncio.Event(), asyncio.Event()
        self._joining: asyncio.Task[None] | None = None

    @property
    def now_ns(self) -> int:
        """The plant's time; by the wall from there on once it was left."""
        return self._now_ns + round(1e9 * (time.monotonic() - self._newest_s)) if self._left else self._now_ns

    @property
    def standing(self) -> WaitedFor | None:
        """Whom the plant waits for, or that it gives no sign of life itself."""
        seconds = time.monotonic() - self._newest_s
        if self._stands is not None and self._stands.name:
            return WaitedFor(self._stands.name, 1e-9 * self._stands.time_ns + seconds)
        gone = self._transport is None or not (self._acting or self._held)
        return WaitedFor(PLANT, seconds) if gone and seconds >= UNANSWERED_S else None

    def call_at(self, when_ns: int, call: Call) -> Cancellable:
        """Have ``call`` called once a tick has passed ``when_ns``."""
        if self._left:
            return WallClock().call_at(when_ns - self.now_ns + time.monotonic_ns(), call)
        timer = _Timer(call)
        heapq.heappush(self._timers, (when_ns, next(self._order), timer))
        return timer

    @contextlib.contextmanager
    def holding(self) -> Iterator[None]:
        """A block in which no tick is answered: what it waits for belongs to the present time."""
        self._holds += 1
        try:
            yield
        finally:
            self._holds -= 1

    async def computed(self, thread: Executor, work: Callable[[], T], takes_ns: int) -> T:
        """What ``work`` in a thread comes to, ``takes_ns`` later; at once where the clock is held.

        For the thread it is the time of now all the while.
        """
        due_ns, began_ns = self._now_ns + takes_ns, self._now_ns

        def at_that_time() -> T:
            _of_thread.time_ns = began_ns
            return work()

        begun = asyncio.get_running_loop().run_in_executor(thread, at_that_time)
        begun.add_done_callback(lambda _: self._wake())
        timer = self.call_at(due_ns, self._wake)
        try:
            while self._now_ns < due_ns and not (begun.done() and self._held) and not self._left:
                await self._news.wait()
        finally:
            timer.cancel()
        with self.holding():
            if self._tick is not None and not begun.done():  # it is at work: nobody is to be named
                self._send(TickKind.HELD, self._tick.number)
            return await begun

    async def until_held(self) -> None:
        """Return when the tick is held on purpose; after UNANSWERED_S of wall time in any case."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(UNANSWERED_S):
                while not self._held:
                    await self._news.wait()

    async def join(self, period_ns: int = 0) -> None:
        """Return when the plant has told the time. ``period_ns``: of the part, 0 where it has none."""
        self._period_ns = period_ns
        self._joining = asyncio.create_task(self._keep_joining())
        await self._known.wait()

    def ready(self) -> None:
        """Have the plant wait for this part from now on."""
        self._ready = True
        self._send(TickKind.READY)

    def leave(self) -> None:
        """Go on by the wall: this process ends, and the plant must not wait for it."""
        if self._left:
            return
        self._newest_s, self._left = time.monotonic(), True
        self._known.set()
        self._news.set()
        if self._joining is not None:
            self._joining.cancel()
        if self._transport is not None:
            self._transport.close()
        waiting, self._timers = self._timers, []
        for when_ns, _, timer in waiting:
            if timer.call is not None:
                self.call_at(when_ns, timer.call)

    def idle(self) -> bool:
        """For the loop, when it has nothing left to do: whether there is something now."""
        tick = self._tick
        if tick is None or self._left or self._holds:
            return False
        if not self._acting:
            self._acting = True
            self.pictures += bool(tick.flags & PICTURE)
            self._set_time(tick)
            self._call_due()
            return True
        if not all(ready() for ready in self.ready_to_answer):
            return False
        if not self.passes():
            if not self._held:
                self._held = True
                self._wake()
                self._send(TickKind.HELD, tick.number)
                return True
            return False
        self._answered()
        self._send(TickKind.DONE, tick.number, self._next_ns(), SENT * self.sent)
        self.sent = False
        return False

    # asyncio's side
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.WriteTransport)
        self._transport, self._buffer = transport, b""
        transport.write(encode(ClockMessage(TickKind.JOIN, 0, self._now_ns, self._period_ns, 0, self._name)))

    def data_received(self, data: bytes) -> None:
        try:
            messages, self._buffer = decode(self._buffer + data)
        except LinkLost:
            assert self._transport is not None
            self._transport.abort()
            return
        for message in messages:
            self._newest_s = time.monotonic()
            self._stands = message if message.kind is TickKind.STANDS else None
            if self._stands is not None:
                continue
            if self._known.is_set():  # a plant that was started anew may count from an earlier time
                self.offset_ns = max(self.offset_ns, self._now_ns - message.time_ns)
            if message.kind is TickKind.TICK:
                self._answered()
                self._tick = message
                if message.flags & IN_VAIN:
                    self.in_vain()
            elif message.kind is TickKind.TIME:  # it is known before others act, and nothing is done yet
                self._set_time(message)
            self._known.set()

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        self._answered()

    def _wake(self) -> None:
        self._news.set()
        self._news = asyncio.Event()

    def _answered(self) -> None:
        self._tick, self._acting, self._held = None, False, False

    def _set_time(self, message: ClockMessage) -> None:
        self._now_ns = message.time_ns + self.offset_ns
        self.pace = 1e-6 * message.value

    def _call_due(self) -> None:
        loop = asyncio.get_running_loop()
        while self._timers and self._timers[0][0] <= self._now_ns:
            if (call := heapq.heappop(self._timers)[2].call) is not None:
                loop.call_soon(call)
        for call in self.on_time:
            loop.call_soon(call)

    async def _keep_joining(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            if self._transport is None:
                with contextlib.suppress(OSError):
                    await loop.create_connection(lambda: self, *self._where)
                    if self._ready:
                        self._send(TickKind.READY)
            await asyncio.sleep(_AGAIN_S)

    def _next_ns(self) -> int:
        """When something is due next, by the plant's clock; what is cancelled goes."""
        while self._timers and self._timers[0][2].call is None:
            heapq.heappop(self._timers)
        return self._timers[0][0] - self.offset_ns if self._timers else _NEVER_NS

    def _send(self, kind: TickKind, number: int = 0, time_ns: int = 0, flags: int = 0) -> None:
        if self._transport is not None:
            self._transport.write(encode(ClockMessage(kind, number, time_ns, 0, flags)))


class _IdleSelector(selectors.DefaultSelector):
    """Asks ``idle`` before it waits: it is only told to wait when the loop has nothing left to do."""

    def __init__(self, idle: Callable[[], bool]) -> None:
        super().__init__()
        self.idle = idle

    def select(self, timeout: float | None = None) -> list[Any]:
        ready = super().select(0)
        if ready or timeout == 0 or self.idle():
            return ready
        return super().select(timeout)


class IdleLoop(asyncio.SelectorEventLoop):
    """asyncio's own loop, which tells ``clock`` when it has nothing left to do (uvloop cannot)."""

    def __init__(self, clock: PlantClock) -> None:
        super().__init__(_IdleSelector(clock.idle))


_current: WallClock | PlantClock = WallClock()
_of_thread = threading.local()


def now_ns() -> int:
    """The time of this process; in a thread that computes for a program, the time at which it began."""
    fixed_ns: int | None = getattr(_of_thread, "time_ns", None)
    return _current.now_ns if fixed_ns is None else fixed_ns


async def sleep(seconds: float) -> None:
    """Return after so much of this process's time."""
    over = asyncio.Event()
    timer = _current.call_at(now_ns() + round(1e9 * seconds), over.set)
    try:
        await over.wait()
    finally:
        timer.cancel()


def current() -> WallClock | PlantClock:
    """The clock of this process."""
    return _current


def is_wall() -> bool:
    """Whether the time of this process is the machine's."""
    return type(_current) is WallClock


def followed() -> PlantClock | None:
    """The plant's clock, where this process follows it."""
    return _current if isinstance(_current, PlantClock) else None


def follow(name: str) -> Callable[[], asyncio.AbstractEventLoop] | None:
    """Have this process follow the plant's clock that the environment names, as the part ``name``.

    Returns what makes the loop for it; None where the environment names none. Raises ConfigurationError.
    """
    where = clock_address()
    if not name or where is None:
        return None
    clock = PlantClock(where, name)
    use(clock)
    return functools.partial(IdleLoop, clock)


def use(clock: WallClock | PlantClock) -> None:
    """Have this process take its time from ``clock``."""
    global _current
    _current = clock


def clock_address() -> tuple[str, int] | None:
    """Host and port of the plant's clock that the environment names. Raises ConfigurationError."""
    named = os.environ.get(CLOCK, "")
    return host_and_port(named, f"{CLOCK}={named!r}") if named else None
