"""How the plant's time passes: by the wall, or in ticks that every part answers before the next one.

Source: docs/plant_clock.md. The time is never ahead of the wall's, times the pace, and what is late
is not made up for: a slow machine is slow.
"""

import asyncio
import os
import socket
import time
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

from foundation.clock import PACE, PLANT, UNANSWERED_S, GivenClock
from foundation.event_log import EventLog
from foundation.incidents import note_incident
from foundation.periods import DurationHistogram, PeriodicTimer, percent_missed
from protocol.errors import ConfigurationError, LinkLost
from protocol.plant_clock import IN_VAIN, PICTURE, SENT, START_NS, ClockMessage, TickKind, decode, encode

CONTROLLER, RENDERER = "controller", "renderer"
PARTS = (CONTROLLER, "vision_pc")
"""Time begins to pass when all of them are there."""
PERIODS_NS = range(1_000_000, 20_000_001)
"""What a part may ask for."""
GONE_NS = 1_000_000_000
"""So much later begins a plant that is started anew: who followed the one before sees a gap, and says so."""
_BEHIND_S = 0.02  # so late, and not more, is made up for: the timer of a quiet machine is
_LOOK_S = 0.5
_RATED_S = 1.0  # over which the pace is measured


def greatest_pace() -> float | None:
    """The most times real time that the plant goes, None: as it can. Raises ConfigurationError."""
    named = os.environ.get(PACE, "1")
    try:
        pace = None if named == "max" else float(named)
    except ValueError:
        pace = 0.0
    if pace is not None and not 0.0 < pace < 1e6:
        words = "is neither max nor a number above 0"
        raise ConfigurationError("configuration.bad_value", f"{PACE}={named!r} {words}")
    return pace


class _Part(asyncio.Protocol):
    """A part that follows."""

    def __init__(self, ticker: "Ticker") -> None:
        self.name, self.period_ns, self.time_ns, self.ready, self.held = "", 0, 0, False, False
        self._ticker = ticker
        self._buffer = b""
        self._transport: asyncio.Transport | None = None
        self.waiting: asyncio.Future[None] | None = None
        self.number, self.next_ns, self.has_news = 0, 0, True

    def send(self, message: ClockMessage) -> None:
        """Send it; the part reads all."""
        if self._transport is not None:
            self._transport.write(encode(message))

    def go_on(self) -> None:
        """Do not wait for it any longer."""
        if self.waiting is not None and not self.waiting.done():
            self.waiting.set_result(None)

    def close(self) -> None:
        """End the connection."""
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport  # type: ignore[assignment]  # uvloop's is of no class of asyncio's
        self._ticker.parts.append(self)

    def data_received(self, data: bytes) -> None:
        try:
            messages, self._buffer = decode(self._buffer + data)
        except LinkLost:
            self.close()
            return
        for message in messages:
            if message.kind is TickKind.JOIN:
                if message.name not in PARTS or (message.value and message.value not in PERIODS_NS):
                    self.close()
                    return
                self.name, self.period_ns, self.time_ns = message.name, message.value, message.time_ns
                self._ticker.joined(self)
            elif message.kind is TickKind.READY:
                self.ready = True
                self._ticker.changed.set()
            elif message.number == self.number:
                self.held = message.kind is TickKind.HELD
                if message.kind is TickKind.DONE:
                    self.next_ns = message.time_ns
                    self._ticker.sent(self, bool(message.flags & SENT))
                    self.go_on()

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        self._ticker.parts.remove(self)
        self._ticker.changed.set()
        self.go_on()


class TickerBody(NamedTuple):
    """``begins`` is awaited once all are there; ``pass_time`` advances the plant by so many ns.

    ``published``, awaited, returns whether a picture was published that is due; ``ended``: no time passes.
    """

    begins: Callable[[], Awaitable[None]]
    pass_time: Callable[[int], None]
    published: Callable[[int], Awaitable[bool]]
    ended: Callable[[], None]


class Ticker:
    """Lets time pass for ``clock`` and all parts; ``pace``: times real time at most, None: as it can."""

    def __init__(
        self, clock: GivenClock, period_ns: int, pace: float | None, body: TickerBody, log: EventLog
    ) -> None:
        self.parts: list[_Part] = []
        self.changed = asyncio.Event()
        self._clock, self._period_ns, self._pace = clock, period_ns, pace
        self._body, self._log = body, log
        self._number = 0
        self._began = False
        self._in_vain = False
        self._rates: deque[tuple[float, int]] = deque(maxlen=2)
        self._rate_ppm = 0
        self._awaited = ""
        self._since_s = 0.0
        self._named = ""
        self._tasks: list[asyncio.Task[None]] = []
        self._server: asyncio.Server | None = None

    async def start(self, bound: socket.socket) -> None:
        """Serve the clock on a bound socket, and let time pass."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Part(self), sock=bound)
        self._tasks = [asyncio.create_task(each) for each in (self._run(), self._keep_naming())]
        self._tasks[0].add_done_callback(lambda _: self._body.ended())

    async def stop(self) -> None:
        """Let the time stand. Raises what had ended it before, if anything had."""
        for task in self._tasks:
            task.cancel()
        ends = await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._server is not None:
            self._server.close()
        for part in tuple(self.parts):
            part.close()
        for end in ends:
            if isinstance(end, Exception):
                raise end

    def joined(self, part: _Part) -> None:
        """A part has named itself: it is told the time."""
        if not self._began and part.time_ns > START_NS:  # it has followed a plant before, which has gone
            self._clock.given_ns = max(self._clock.given_ns, part.time_ns + GONE_NS)
        part.send(self._message(TickKind.TIME))

    def sent(self, sender: _Part, something: bool) -> None:
        """A part has sent something to the others, or nothing."""
        for part in self.parts:
            part.has_news |= something and part is not sender

    def leave_unanswered(self) -> None:
        """What the controller has asked of the plant gets no answer: it need not be waited for."""
        self._in_vain = True
        for part in self.parts:
            if part.name == CONTROLLER:
                part.go_on()

    async def _run(self) -> None:
        await self._all_there()
        await self._body.begins()
        self._began = True
        due_s = time.monotonic()
        while True:
            periods_ns = [part.period_ns for part in self.parts if part.period_ns]
            period_ns = min(periods_ns, default=self._period_ns)
            due_s = await self._paced(due_s, 1e-9 * period_ns)
            self._clock.given_ns += period_ns
            self._body.pass_time(period_ns)
            self._await(RENDERER)
            picture = await self._body.published(self._clock.given_ns)
            await self._tick(picture)
            self._await("")

    async def _all_there(self) -> None:
        while missing := [name for name in PARTS if not any(p.ready and p.name == name for p in self.parts)]:
            self._await(missing[0])
            self.changed.clear()
            await self.changed.wait()

    async def _paced(self, due_s: float, period_s: float) -> float:
        """When the next tick is due, after waiting for this one."""
        now_s = time.monotonic()
        if self._pace is None:
            await asyncio.sleep(0)  # who else is served by this loop has a turn
            return now_s
        if due_s > now_s:
            await asyncio.sleep(due_s - now_s)
        return max(due_s, now_s - _BEHIND_S) + period_s / self._pace

    async def _tick(self, picture: bool) -> None:
        """Tell every part the time, then have one after the other act that has a reason to; the controller is
        the last.
        """
        self._number += 1
        self._rate()
        parts = sorted((part for part in self.parts if part.ready), key=lambda part: part.name == CONTROLLER)
        now_ns = self._clock.given_ns
        for part in parts[1:]:
            part.send(self._message(TickKind.TIME))
        for part in parts:
            if part not in self.parts:  # it went while another one acted
                continue
            if not (picture or part.has_news or part.name == CONTROLLER or now_ns >= part.next_ns):
                part.send(self._message(TickKind.TIME))
                continue
            part.has_news = False
            flags = PICTURE * picture
            if part.name == CONTROLLER and self._in_vain:
                self._in_vain, flags = False, flags | IN_VAIN
            part.number, part.held = self._number, False
            part.waiting = asyncio.get_running_loop().create_future()
            self._await(part.name)
            part.send(self._message(TickKind.TICK, flags))
            await part.waiting

    def _message(self, kind: TickKind, flags: int = 0) -> ClockMessage:
        return ClockMessage(kind, self._number, self._clock.given_ns, self._rate_ppm, flags)

    def _rate(self) -> None:
        now_s = time.monotonic()
        if not self._rates or now_s - self._rates[-1][0] >= _RATED_S:
            self._rates.append((now_s, self._clock.given_ns))
            (then_s, then_ns), (now_s, now_ns) = self._rates[0], self._rates[-1]
            if now_s > then_s:
                self._rate_ppm = round(1e-3 * (now_ns - then_ns) / (now_s - then_s))

    def _await(self, name: str) -> None:
        self._awaited, self._since_s = name, time.monotonic()

    async def _keep_naming(self) -> None:
        """Name, by the wall, who does not answer."""
        while True:
            await asyncio.sleep(_LOOK_S)
            seconds = time.monotonic() - self._since_s
            held = any(part.held for part in self.parts if part.name == self._awaited)
            name = self._awaited if seconds >= UNANSWERED_S and not held else ""
            if name != self._named:
                self._named = name
                self._name(name, seconds)
            if name:
                for part in self.parts:
                    part.send(ClockMessage(TickKind.STANDS, time_ns=round(1e9 * seconds), name=name))

    def _name(self, name: str, seconds: float) -> None:
        if not name:
            self._log.write("clock_goes_on")
            return
        why = f"{name} has not answered the plant's clock for {seconds:.0f} s: the time of all stands"
        self._log.write("clock_stands", "warning", cause="clock.unanswered", detail=why)
        if self._began:
            note_incident(PLANT, "clock.unanswered", why)


class Integrator:
    """Calls ``step`` every ``period_ns``. In missed periods, which are counted, plant's time stands still.

    ``step`` is given the deadline (CLOCK_MONOTONIC ns) that the plant's state then belongs to.
    ``lateness`` of the periods served, against the oldest deadline unserved; ``missed``: periods skipped.
    """

    def __init__(self, period_ns: int, step: Callable[[int], None]) -> None:
        self.lateness = DurationHistogram()
        self.missed = 0
        self._period_ns = period_ns
        self._step = step
        self._timer: PeriodicTimer | None = None

    def start(self) -> None:
        """Begin at the next whole period of the monotonic clock."""
        first = (time.monotonic_ns() // self._period_ns + 1) * self._period_ns
        self._timer = PeriodicTimer(first, self._period_ns, self._expire)

    def stop(self) -> None:
        """Stand still."""
        if self._timer is not None:
            self._timer.close()
            self._timer = None

    def as_dict(self) -> dict[str, Any]:
        """The statistics by name, unit in the name."""
        served = self.lateness.count
        return {
            "periods_served": served,
            "periods_missed": self.missed,
            "missed_percent": percent_missed(served, self.missed),
            **self.lateness.as_dict("late"),
        }

    def _expire(self) -> None:
        timer = self._timer
        passed = 0 if timer is None else timer.passed()
        if timer is None or passed == 0:
            return
        missed = passed - 1
        self.lateness.add(time.monotonic_ns() - (timer.deadline_ns - missed * self._period_ns))
        self.missed += missed
        self._step(timer.deadline_ns)


class SlowCycle:
    """Says when something slower than the integrator is due: at most once a step; late ones are dropped."""

    def __init__(self, interval_ns: int) -> None:
        self._interval_ns = interval_ns
        self._next_ns = 0
        self.dropped = 0

    def due(self, now_ns: int) -> bool:
        """Return True once an interval."""
        if now_ns < self._next_ns:
            return False
        if self._next_ns:
            late = (now_ns - self._next_ns) // self._interval_ns
            self.dropped += late
            self._next_ns += (late + 1) * self._interval_ns
        else:
            self._next_ns = now_ns + self._interval_ns
        return True
