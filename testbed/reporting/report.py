"""The pages that runs leave: of one style, each one file that needs no other and no network."""

import base64
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from testbed.reporting import outcome as outcomes
from testbed.reporting import plots
from testbed.reporting import run_record as record
from testbed.reporting.console import plain
from testbed.reporting.outcome import Outcome


def rendered(template: str, **values: Any) -> str:
    """The page that ``template`` makes of ``values``, to which the time of writing is added."""
    from jinja2 import Environment, PackageLoader  # here: a command that only lists runs need not wait for it

    environment = Environment(loader=PackageLoader("testbed.reporting"), autoescape=True)
    return environment.get_template(template).render(written=time.strftime("%Y-%m-%d %H:%M:%S"), **values)


_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 88]  # what was recorded keeps every pixel; the report shows it


class Picture(NamedTuple):
    """One picture of the report: PNG bytes and what they show."""

    caption: str
    png: bytes


def write_report(
    directory: Path,
    outcome: Outcome,
    traces: plots.Traces,
    pictures: Sequence[Picture],
    events: Sequence[Mapping[str, Any]],
) -> Path:
    """The HTML file, written to ``directory`` with ``figures.json`` and ``events.jsonl`` beside it.

    It needs no other file and no network: the pictures are inside. What was recorded is linked.
    """
    lines = [json.dumps(plain(event), sort_keys=True, ensure_ascii=False) for event in events]
    (directory / "events.jsonl").write_text("".join(line + "\n" for line in lines), encoding="utf-8")
    figures = outcomes.figures(outcome)
    (directory / "figures.json").write_text(json.dumps(plain(figures), indent=2) + "\n", encoding="utf-8")
    stages = outcome.stages
    html = rendered(
        "report.html.j2",
        outcome=outcome,
        verdict=outcomes.verdict(outcome),
        rows=outcomes.rows(stages),
        plots=[
            ("Beside the object after each look", plots.target_plot(stages)),
            ("True error over time; the shaded band is wanted in x and y", plots.error_plot(traces, stages)),
            ("The arm, by its drawing at the measured joints", plots.arm_plot(traces)),
            ("The tool's way", plots.path_plot(traces, stages)),
            ("Joint tracking at the encoders", plots.joint_plot(traces, stages)),
        ],
        pictures=[(picture.caption, _data_uri(picture.png)) for picture in pictures],
        details={key: value for key, value in plain(outcome.details).items() if key != "directory"},
        run=record.read(directory),
        files=_files(directory),
        spans=spans(events),
        lasted_s=max((line.at_s for line in event_lines(events)), default=0.0),
        events=event_lines(events),
    )
    path = directory / "report.html"
    path.write_text(html, encoding="utf-8")
    return path


def _files(directory: Path) -> list[tuple[str, str]]:
    """What the run left behind: paths below ``directory``, and their sizes."""
    files = sorted(path for path in directory.rglob("*") if path.is_file() and path.name != "report.html")
    return [
        (path.relative_to(directory).as_posix(), f"{1e-3 * path.stat().st_size:,.0f} kB") for path in files
    ]


def _data_uri(png: bytes) -> str:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None  # it was encoded here
    jpeg = cv2.imencode(".jpg", picture, _JPEG)[1].tobytes()
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode("ascii")


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
