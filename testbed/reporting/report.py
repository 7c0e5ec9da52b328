"""Writes the report of a run: one HTML file with everything in it, figures and events beside it."""

import base64
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader

from protocol.errors import ConfigurationError
from testbed.reporting import outcome as outcomes
from testbed.reporting import plots
from testbed.reporting.console import plain
from testbed.reporting.outcome import Outcome


class Picture(NamedTuple):
    """One picture of the report: PNG bytes and what they show."""

    caption: str
    png: bytes


@contextmanager
def run_directory(runs: Path) -> Iterator[Path]:
    """A new directory below ``runs``, named by the time of day; one left empty is removed with the block.

    Raises ConfigurationError where none can be made.
    """
    there = runs.exists()
    directory = _new_directory(runs)
    try:
        yield directory
    finally:
        with suppress(OSError):  # it holds something
            directory.rmdir()
            if not there:
                runs.rmdir()


def _new_directory(runs: Path) -> Path:
    stamp = time.strftime("%Y%m%d-%H%M%S")
    for attempt in range(100):
        directory = runs / (stamp if attempt == 0 else f"{stamp}-{attempt}")
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise ConfigurationError("output.unwritable", f"{directory}: {error.strerror}") from error
        return directory
    raise ConfigurationError("output.unwritable", f"{runs / stamp}: a hundred runs in one second")


def write_report(
    directory: Path,
    outcome: Outcome,
    traces: plots.Traces,
    pictures: Sequence[Picture],
    events: Sequence[Mapping[str, Any]],
) -> Path:
    """The HTML file, written to ``directory`` with ``figures.json`` and ``events.jsonl`` beside it.

    It needs no other file and no network: the pictures are inside.
    """
    lines = [json.dumps(plain(event), sort_keys=True, ensure_ascii=False) for event in events]
    (directory / "events.jsonl").write_text("".join(line + "\n" for line in lines), encoding="utf-8")
    figures = outcomes.figures(outcome)
    (directory / "figures.json").write_text(json.dumps(plain(figures), indent=2) + "\n", encoding="utf-8")
    drawn = (
        Picture("The tool's way", plots.path_plot(traces, outcome.stages)),
        Picture(
            "True error over time; the shaded band is wanted in x and y",
            plots.error_plot(traces, outcome.stages),
        ),
        Picture("Beside the object after each look", plots.target_plot(outcome.stages)),
        Picture("Joint tracking at the encoders", plots.joint_plot(traces, outcome.stages)),
    )
    environment = Environment(loader=PackageLoader("testbed.reporting"), autoescape=True)
    html = environment.get_template("report.html.j2").render(
        outcome=outcome,
        verdict=outcomes.verdict(outcome),
        headings=outcomes.HEADINGS,
        rows=outcomes.rows(outcome.stages),
        plots=[(picture.caption, _data_uri(picture.png)) for picture in drawn],
        pictures=[(picture.caption, _data_uri(picture.png)) for picture in pictures],
        details=plain(outcome.details),
        events=lines,
        written=time.strftime("%Y-%m-%d %H:%M:%S"),
    )
    path = directory / "report.html"
    path.write_text(html, encoding="utf-8")
    return path


def _data_uri(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
