"""One thing made again and again for everybody who follows it, and only while somebody does."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable

from protocol.errors import LongreachError, RequestRefused

_AFTER_TROUBLE_S = 0.25


class Broadcast:
    """``make`` is awaited every ``period_s`` while there are followers; each follower gets the newest.

    A follower that is slow skips what was made meanwhile; nothing waits for it, and nothing is queued. What
    ``make`` raises on purpose is taken for "nothing new"; it is asked again. All in one event loop.
    """

    def __init__(self, make: Callable[[], Awaitable[bytes]], period_s: float, most: int, what: str) -> None:
        self._make, self._period_s, self._most, self._what = make, period_s, most, what
        self._followers = 0
        self._newest = b""
        self._number = 0
        self._news = asyncio.Event()
        self._making: asyncio.Task[None] | None = None

    @property
    def followers(self) -> int:
        """How many follow."""
        return self._followers

    def refuse_more(self) -> None:
        """Raises RequestRefused (``refused.too_many_followers``) when there is no place for one more."""
        if self._followers >= self._most:
            why = f"{self._most} clients follow {self._what} already"
            raise RequestRefused("refused.too_many_followers", why)

    async def follow(self) -> AsyncIterator[bytes]:
        """What is made from now on."""
        self._followers += 1
        if self._making is None:
            self._making = asyncio.create_task(self._keep_making(), name=f"making {self._what}")
        try:
            seen = self._number
            while True:
                while self._number == seen:
                    await self._news.wait()
                seen = self._number
                yield self._newest
        finally:
            self._followers -= 1
            if not self._followers and self._making is not None:
                self._making.cancel()
                self._making = None

    async def _keep_making(self) -> None:
        loop = asyncio.get_running_loop()
        with contextlib.suppress(asyncio.CancelledError):
            while True:
                began_s = loop.time()
                try:
                    self._newest = await self._make()
                except LongreachError:
                    await asyncio.sleep(_AFTER_TROUBLE_S)
                    continue
                self._number += 1
                self._news.set()
                self._news = asyncio.Event()
                await asyncio.sleep(max(self._period_s - (loop.time() - began_s), 0.0))
