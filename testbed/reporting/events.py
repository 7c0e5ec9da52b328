"""A run's events for its report: a line for each, and which operations lasted from when to when."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

_SAID = frozenset({"service", "event", "level", "time_ns", "utc", "cycle_ns"})
_BEGINS = ("operation_queued", "operation")
_ENDS = "operation_ended"
_WORDS = 160  # of a line; all of the event is behind it
_LEFT_OUT = frozenset({"state"})  # a sample, not an event


class EventLine(NamedTuple):
    """One event: seconds after the first, who told it, its level, what it says in short, and all of it."""

    at_s: float
    service: str
    level: str
    event: str
    words: str
    whole: str


class OperationSpan(NamedTuple):
    """An operation from ``begin_s`` to ``end_s`` after the first event; ``trouble``: why it failed."""

    kind: str
    begin_s: float
    end_s: float
    trouble: str


def event_lines(events: Sequence[Mapping[str, Any]]) -> list[EventLine]:
    """A line for each event but samples of the state."""
    begin_ns = _begin_ns(events)
    return [
        EventLine(
            1e-9 * (event.get("time_ns", begin_ns) - begin_ns),
            str(event.get("service", "")),
            str(event.get("level", "info")),
            str(event.get("event", "")),
            _short(_words((key, value) for key, value in event.items() if key not in _SAID)),
            json.dumps(event, indent=1, ensure_ascii=False),
        )
        for event in events
        if event.get("event") not in _LEFT_OUT
    ]


def spans(events: Sequence[Mapping[str, Any]]) -> list[OperationSpan]:
    """The operations in order. One that has not ended lasts until the last event."""
    begin_ns = _begin_ns(events)
    found: list[OperationSpan] = []
    running: tuple[str, float] | None = None
    at_s = 0.0
    for event in events:
        at_s = 1e-9 * (event.get("time_ns", begin_ns) - begin_ns)
        if event.get("event") in _BEGINS:
            running = str(event.get("kind", "")), at_s
        elif event.get("event") == _ENDS and running is not None:
            problem = event.get("problem") or {}
            found.append(OperationSpan(*running, at_s, str(problem.get("cause", "")) if problem else ""))
            running = None
    return found if running is None else [*found, OperationSpan(*running, at_s, "has not ended")]


def _begin_ns(events: Sequence[Mapping[str, Any]]) -> int:
    return next((int(event["time_ns"]) for event in events if "time_ns" in event), 0)


def _words(fields: Iterable[tuple[str, Any]]) -> str:
    return ", ".join(f"{key} {_value(value)}" for key, value in fields if value not in (None, "", {}, []))


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return f"({_words(value.items())})"
    if isinstance(value, (list, tuple)):
        return " ".join(map(_value, value))
    return str(value)


def _short(text: str) -> str:
    return text if len(text) <= _WORDS else text[: _WORDS - 1] + "…"
