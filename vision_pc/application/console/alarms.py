"""Alarms: what is wrong, since when, how often, and what to do about it."""

import itertools
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

from vision_pc.application.console.advice import advice

URGENT, HIGH, LOW = 1, 2, 3  # at once; soon; when there is time
OFF_DELAY_S = 2.0
CRASHED = "service.crashed"
_KEPT = 100


class Condition(NamedTuple):
    """Something that is wrong at present. ``priority``: URGENT, HIGH or LOW. ``began_s`` None: now."""

    priority: int
    detail: str
    began_s: float | None = None


class Alarm(NamedTuple):
    """One cause. Times are seconds since 1970; ``ended_s`` is None while it lasts, ``times`` how often it
    came: ``began_s`` is when it came last.
    """

    number: int
    cause: str
    priority: int
    detail: str
    began_s: float
    ended_s: float | None
    times: int = 1


class AlarmList:
    """The newest alarms, active and ended, one row a cause, bounded in number.

    A condition that is gone for less than ``OFF_DELAY_S`` has not ended (ISA-18.2: no chatter).
    """

    def __init__(self) -> None:
        self._active: dict[str, Alarm] = {}
        self._gone_s: dict[str, float] = {}  # active ones that are not seen at present, and since when
        self._ended: deque[Alarm] = deque(maxlen=_KEPT)
        self._numbers = itertools.count(1)

    def update(self, now_s: float, conditions: Mapping[str, Condition]) -> None:
        """Take note of all that is wrong at ``now_s``, by cause; what is missing long enough has ended."""
        for cause in [cause for cause in self._active if cause not in conditions]:
            gone_s = self._gone_s.setdefault(cause, now_s)
            if now_s - gone_s >= OFF_DELAY_S:
                self._ended.appendleft(self._active.pop(cause)._replace(ended_s=gone_s))
                del self._gone_s[cause]
        for cause, (priority, detail, began_s) in conditions.items():
            self._gone_s.pop(cause, None)
            known, came_s = self._active.get(cause), now_s if began_s is None else began_s
            new = Alarm(next(self._numbers), cause, priority, detail, came_s, None, self._times(cause) + 1)
            self._active[cause] = new if known is None else known._replace(priority=priority, detail=detail)
            self._forget(cause)

    def happened(self, now_s: float, cause: str, detail: str, priority: int = LOW) -> None:
        """Take note of what was over as soon as it had happened, such as an operation that failed."""
        times = self._times(cause) + 1
        self._forget(cause)
        self._ended.appendleft(Alarm(next(self._numbers), cause, priority, detail, now_s, now_s, times))

    def _times(self, cause: str) -> int:
        return sum(alarm.times for alarm in self._ended if alarm.cause == cause)

    def _forget(self, cause: str) -> None:
        for alarm in [alarm for alarm in self._ended if alarm.cause == cause]:
            self._ended.remove(alarm)

    @property
    def rows(self) -> list[Alarm]:
        """The active ones, the most urgent first, of those a crash, which has others follow, then the newest;
        then those that ended, newest first.
        """
        active = sorted(self._active.values(), key=lambda a: (a.priority, a.cause != CRASHED, -a.number))
        return [*active, *self._ended]


def alarm_json(alarm: Alarm) -> dict[str, Any]:
    """An alarm with what to do about it."""
    return {
        "number": alarm.number,
        "cause": alarm.cause,
        "priority": alarm.priority,
        "detail": alarm.detail,
        "advice": advice(alarm.cause),
        "began_at": alarm.began_s,
        "ended_at": alarm.ended_s,
        "count": alarm.times,
    }
