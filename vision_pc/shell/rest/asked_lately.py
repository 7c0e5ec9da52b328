"""Refuses what a console asked while it showed a machine that is another by now: a network may hold a request
up and bring it when the operator has long turned to something else.
"""

import math
import time
from collections.abc import Awaitable, Callable, Collection

from fastapi import Request

from protocol.errors import RequestRefused

SHOWN = "longreach-shown"
MOST_S = 5.0  # a busy machine has answered within 2 s
_JUDGED = frozenset({"POST", "PUT", "PATCH"})  # DELETE forgets, whenever it comes


def asked_lately(stops: Collection[str]) -> Callable[[Request], Awaitable[None]]:
    """A dependency that raises RequestRefused for a request that its header ``Longreach-Shown`` dates back.

    The header is the ``time`` (s) of the snapshot that the console showed, on this machine's own clock.
    Causes: ``refused.asked_too_late`` after ``MOST_S``, ``request.bad_header`` for what is no time. Who sends
    none is not judged, nor are the paths ``stops`` and the end of an operation.
    """

    async def judge(request: Request) -> None:
        shown, path = request.headers.get(SHOWN), request.url.path
        if shown is None or request.method not in _JUDGED or path in stops or path.endswith("/cancel"):
            return
        age_s = time.time() - _seconds(shown)
        if abs(age_s) > MOST_S:
            why = f"asked of what was shown {age_s:.1f} s ago, at most {MOST_S:g} s: nothing was done"
            raise RequestRefused("refused.asked_too_late", why)

    return judge


def _seconds(shown: str) -> float:
    try:
        seconds = float(shown)
    except ValueError:
        seconds = math.nan
    if not math.isfinite(seconds):
        why = f"Longreach-Shown: {shown[:40]!r} is no time; wanted the snapshot's, in seconds"
        raise RequestRefused("request.bad_header", why)
    return seconds
