"""The report tells the outcome truly, needs nothing beside it, and never shows a failed look as a zero."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from testbed.reporting import plots
from testbed.reporting.outcome import Errors, Outcome, Stage
from testbed.reporting.report import Picture, write_report
from testbed.reporting.run_record import beginning


def errors(x_mm: float, y_mm: float, z_mm: float) -> Errors:
    return Errors(np.array([x_mm, y_mm, z_mm]) / 1e3, 0.01)


def run(*after_looks: Errors, looks: int = 2) -> Outcome:
    stages = [Stage("start", 0, 1.0, errors(120.0, -80.0, 400.0), errors(118.0, -79.0, 402.0))]
    stages.append(Stage("trajectory matching", 0, 20.0, None, errors(100.0, -60.0, 400.0), "18 samples"))
    for number, true in enumerate(after_looks, 1):
        stages.append(Stage(f"look {number}", number, 20.0 + 20.0 * number, errors(0.5, -0.5, 1.0), true))
    return Outcome(
        "lockstep", "standard", 4, looks, tuple(stages), 30.0, 80.0, {"event_log_sha256": "0f" * 32}
    )


@pytest.fixture
def trace() -> plots.ErrorTrace:
    time_s = np.linspace(0.0, 80.0, 900)
    return plots.ErrorTrace(time_s, np.stack([0.4 - 0.005 * time_s] * 3, 1))


@pytest.mark.parametrize(
    ("last", "passed"),
    [
        (errors(4.99, -4.99, 50.0), True),  # depth is not asked for
        (errors(5.01, 0.0, 0.0), False),
        (errors(0.0, -5.01, 0.0), False),
        (errors(float("nan"), 0.0, 0.0), False),
    ],
)
def test_the_verdict_is_about_true_x_and_y_after_the_last_look(last: Errors, passed: bool) -> None:
    made = run(errors(9.0, 9.0, 9.0), last)
    assert made.passed is passed
    assert ("NOT within" in made.verdict) is not passed


def test_a_run_that_did_not_get_to_its_last_look_has_not_passed() -> None:
    made = run(errors(1.0, 1.0, 1.0))
    assert not made.passed
    assert "look 2 was not reached; the last stage was: look 1" in made.verdict


EVENTS: list[dict[str, object]] = [
    {"time_ns": 5_000, "event": "operation_queued", "kind": "look", "service": "vision_pc", "level": "info"},
    {"time_ns": 3_000_005_000, "event": "<script>alert(1)</script>", "level": "warning", "detail": "late"},
]


def reported(directory: Path, trace: plots.ErrorTrace) -> str:
    made = run(errors(1.0, 1.0, 1.0), errors(1.0, -2.0, 3.0))
    _, png = cv2.imencode(".png", np.full((72, 128, 3), 90, np.uint8))
    path = write_report(
        directory, made, trace, [Picture("before & after", png.tobytes())], EVENTS, beginning()
    )
    return path.read_text(encoding="utf-8")


def test_the_report_is_one_file_with_its_pictures_inside(tmp_path: Path, trace: plots.ErrorTrace) -> None:
    html = reported(tmp_path, trace)
    assert len(re.findall(r'src="data:image/jpeg;base64,', html)) == len(re.findall(r"\bsrc=", html)) == 2
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', html)
    assert "<script>" not in html
    assert "within ±5 mm in x and y" in html
    assert "before &amp; after" in html
    assert json.loads((tmp_path / "figures.json").read_text())["passed"] is True
    assert json.loads((tmp_path / "events.jsonl").read_text().splitlines()[0]) == EVENTS[0]
