"""When the plant's time passes, as the vision PC has it: always, on request, or not at all."""

import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from enum import StrEnum

from foundation import clock
from protocol.errors import ConfigurationError, RequestRefused

GOES = "LONGREACH_CLOCK_GOES"
"""The environment's variable for the mode that the clock begins in."""
_AFTER_STOP_NS = 100_000_000


class Goes(StrEnum):
    """``on_request``: while a request that may move something, or an operation, is under way."""

    ALWAYS = "always"
    ON_REQUEST = "on_request"
    NEVER = "never"


class MachineClock:
    """The plant's clock as people see it, or the wall's, which nobody holds.

    ``at_work``: whether an operation runs, or the machine is not all there yet; ``on_held`` is told whether
    a person holds it.
    """

    def __init__(self, at_work: Callable[[], bool] = lambda: False) -> None:
        """Raises ConfigurationError for a mode that is none."""
        self.at_work = at_work
        self.on_held: Callable[[bool], None] = lambda _held: None
        self._requests = 0
        self._stopped_ns = -_AFTER_STOP_NS
        named = os.environ.get(GOES, Goes.ALWAYS)
        if named not in [*Goes]:
            raise ConfigurationError(
                "configuration.bad_value", f"{GOES}={named!r} is none of {', '.join(Goes)}"
            )
        self._goes = Goes(named)
        self._clock = clock.current()
        if isinstance(self._clock, clock.PlantClock):
            self._clock.passes = self._passes

    @property
    def of_plant(self) -> bool:
        """Whether it is the plant's clock."""
        return isinstance(self._clock, clock.PlantClock)

    @property
    def goes(self) -> Goes:
        """When it goes."""
        return self._goes

    @property
    def now_ns(self) -> int:
        """What time it is."""
        return self._clock.now_ns

    @property
    def pace(self) -> float:
        """How many times as fast as real time it went in the last second."""
        return self._clock.pace

    @property
    def standing(self) -> clock.WaitedFor | None:
        """Who is waited for."""
        return self._clock.standing

    def let_go(self, goes: Goes) -> None:
        """Have it go so from now on. Raises RequestRefused (``refused.wall_clock``) for the wall's."""
        if not self.of_plant:
            raise RequestRefused("refused.wall_clock", "the clock is the wall's: it is not held")
        self._goes = goes
        self.on_held(goes is Goes.NEVER)

    def stopped(self) -> None:
        """A stop was sent: it is obeyed at the next tick, and seen soon after."""
        self._stopped_ns = self.now_ns

    @asynccontextmanager
    async def requested(self) -> AsyncIterator[None]:
        """A block in which a request is under way. Raises RequestRefused where time does not pass for it.

        On request and alone, it begins at the tick that is held: after an answer that came between two ticks
        it is the same one, however soon its client asks again.
        """
        if self._goes is Goes.NEVER:
            raise RequestRefused(
                "refused.clock_held", "the clock is held: nothing can be done before it goes"
            )
        alone = self._goes is Goes.ON_REQUEST and not (self._requests or self.at_work())
        if alone and isinstance(self._clock, clock.PlantClock):
            await self._clock.until_held()
        self._requests += 1
        try:
            yield
        finally:
            self._requests -= 1

    def _passes(self) -> bool:
        if self._goes is Goes.ON_REQUEST:
            recent = self.now_ns - self._stopped_ns < _AFTER_STOP_NS
            return self._requests > 0 or recent or self.at_work()
        return self._goes is Goes.ALWAYS
