"""Requests that wait for the end of what they begin: ``Prefer: wait=N`` (RFC 7240, section 4.3)."""

import asyncio
import re
from collections.abc import Iterable
from contextlib import suppress

from vision_pc.shell.rest.operations import Operation

MAX_WAIT_S = 3600
MAX_WAITING = 64  # as of those who follow; who comes then is answered at once
_WAIT = re.compile(r'(?:^|,)\s*wait\s*=\s*"?(\d{1,9})"?\s*(?:[;,]|$)', re.IGNORECASE)


def preferred_wait_s(fields: Iterable[str]) -> int | None:
    """The first ``wait`` of the header's fields, at most ``MAX_WAIT_S``; None where there is none.

    What is not understood is ignored, as the RFC wants it.
    """
    found = _WAIT.search(",".join(fields))
    return None if found is None else min(int(found[1]), MAX_WAIT_S)


class Waiting:
    """Those who wait at present."""

    def __init__(self) -> None:
        self._count = 0

    async def for_end(self, operation: Operation, wait_s: int) -> bool:
        """Whether there was a place to wait at: until ``operation`` has ended, or ``wait_s`` have passed."""
        if self._count >= MAX_WAITING:
            return False
        self._count += 1
        try:
            with suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    seen = -1
                    while not operation.state.ended:
                        seen = await operation.changed(seen)
        finally:
            self._count -= 1
        return True
