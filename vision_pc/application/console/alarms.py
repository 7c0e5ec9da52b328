"""Alarms: conditions that want a person, from when they began until they ended, kept for who comes later."""

import itertools
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

from vision_pc.application.console.advice import advice

URGENT, HIGH, LOW = 1, 2, 3  # at once; soon; when there is time
_KEPT = 100


class Condition(NamedTuple):
    """Something that is wrong at present. ``priority``: URGENT, HIGH or LOW."""

    priority: int
    detail: str


class Alarm(NamedTuple):
    """One alarm. Times are seconds since 1970; ``ended_s`` is None while it lasts."""

    number: int
    cause: str
    priority: int
    detail: str
    began_s: float
    ended_s: float | None


class AlarmList:
    """The newest alarms, active and ended, bounded in number."""

    def __init__(self) -> None:
        self._active: dict[str, Alarm] = {}
        self._ended: deque[Alarm] = deque(maxlen=_KEPT)
        self._numbers = itertools.count(1)

    def update(self, now_s: float, conditions: Mapping[str, Condition]) -> None:
        """Take note of all that is wrong at ``now_s``, by cause; what is missing has ended."""
        for cause in [cause for cause in self._active if cause not in conditions]:
            self._ended.appendleft(self._active.pop(cause)._replace(ended_s=now_s))
        for cause, (priority, detail) in conditions.items():
            known = self._active.get(cause)
            if known is None:
                number = next(self._numbers)
                self._active[cause] = Alarm(number, cause, priority, detail, now_s, None)
            else:
                self._active[cause] = known._replace(priority=priority, detail=detail)

    def happened(self, now_s: float, cause: str, detail: str, priority: int = LOW) -> None:
        """Take note of what was over as soon as it had happened, such as an operation that failed."""
        self._ended.appendleft(Alarm(next(self._numbers), cause, priority, detail, now_s, now_s))

    @property
    def rows(self) -> list[Alarm]:
        """The active ones, the most urgent and then the newest first; then those that ended, newest first."""
        active = sorted(self._active.values(), key=lambda alarm: (alarm.priority, -alarm.number))
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
    }
