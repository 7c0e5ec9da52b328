"""Places among the requests that the service behind a door has not begun to answer."""

import asyncio
import contextlib
import resource
from collections.abc import AsyncIterator, Callable

_AT_THE_SERVICE = 4  # requests that it has not begun to answer
_ANSWERED_WITHIN_S = 0.25  # who waits longer waits for something else than its processor
_FILES = 4096  # more than connections, so that one too many that asks for a stop is accepted


class ServiceSlots:
    """A few places, each left once, after a short while in any case."""

    def __init__(self) -> None:
        self._unanswered = asyncio.Semaphore(_AT_THE_SERVICE)

    @contextlib.asynccontextmanager
    async def slot(self) -> AsyncIterator[Callable[[], None]]:
        """A place among those that the service has not begun to answer; calling it lets another in."""
        await self._unanswered.acquire()
        with contextlib.ExitStack() as place:
            place.callback(self._unanswered.release)
            late = asyncio.get_running_loop().call_later(_ANSWERED_WITHIN_S, place.close)
            place.callback(late.cancel)
            yield place.close


def allow_files() -> None:
    """Let this process have as many open files as it may, up to ``_FILES``."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < _FILES:
        allowed = _FILES if hard == resource.RLIM_INFINITY else min(_FILES, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, allowed), hard))
