"""The page that a run leaves: one file that needs no other and no network."""

import base64
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from testbed.reporting import outcome as outcomes
from testbed.reporting.console import plain
from testbed.reporting.outcome import Outcome
from testbed.reporting.plots import ErrorTrace, error_figure

_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 88]  # what was recorded keeps every pixel; the report shows it


class Picture(NamedTuple):
    """One picture of the report: PNG bytes and what they show."""

    caption: str
    png: bytes


def write_report(
    directory: Path,
    outcome: Outcome,
    trace: ErrorTrace,
    pictures: Sequence[Picture],
    events: Sequence[Mapping[str, Any]],
    run: Mapping[str, Any],
) -> Path:
    """The HTML file, written to ``directory`` with ``results.json`` and ``events.jsonl`` beside it.

    It needs no other file and no network: the pictures are inside. ``run``: what made it.
    """
    from jinja2 import Environment, PackageLoader  # here: `longreach up` need not wait for it

    lines = [json.dumps(plain(event), sort_keys=True, ensure_ascii=False) for event in events]
    (directory / "events.jsonl").write_text("".join(line + "\n" for line in lines), encoding="utf-8")
    results = outcomes.results(outcome)
    (directory / "figures.json").write_text(json.dumps(plain(results), indent=2) + "\n", encoding="utf-8")
    drawn = io.BytesIO()
    error_figure(trace, outcome.stages).savefig(drawn, format="png", dpi=110)
    caption = "True error over time and after each look; the shaded band and square are wanted in x and y"
    shown = [Picture(caption, drawn.getvalue()), *pictures]
    template = Environment(loader=PackageLoader("testbed.reporting"), autoescape=True)
    html = template.get_template("report.html.j2").render(
        outcome=outcome,
        headings=outcomes.HEADINGS,
        rows=outcomes.rows(outcome.stages),
        pictures=[(picture.caption, _data_uri(picture.png)) for picture in shown],
        run=run,
    )
    path = directory / "report.html"
    path.write_text(html, encoding="utf-8")
    return path


def _data_uri(png: bytes) -> str:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None  # it was encoded here
    jpeg = cv2.imencode(".jpg", picture, _JPEG)[1].tobytes()
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode("ascii")
