"""Writes the report of a run: one HTML file with everything in it, figures and events beside it."""

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from testbed.reporting import outcome as outcomes
from testbed.reporting import plots
from testbed.reporting import run_record as record
from testbed.reporting.console import plain
from testbed.reporting.events import event_lines, spans
from testbed.reporting.outcome import Outcome
from testbed.reporting.pages import rendered

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
