"""The report tells the outcome truly, needs nothing beside it, and never shows a failed look as a zero."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from protocol.errors import ConfigurationError
from testbed.reporting import outcome as outcomes
from testbed.reporting import plots
from testbed.reporting.outcome import Errors, Outcome, Stage
from testbed.reporting.report import Picture, run_directory, write_report


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
def traces() -> plots.Traces:
    time_s, view_s = np.linspace(0.0, 80.0, 900), np.linspace(0.0, 80.0, 300)
    way = np.stack([3.9 + 0.003 * time_s, 0.1 * np.sin(time_s / 9), 1 + 0.1 * np.cos(time_s / 7)], 1)
    joints = np.stack([np.sin(view_s / (5 + joint)) for joint in range(6)], 1)
    return plots.Traces(time_s, way, 0.4 - 0.005 * way, view_s, way[::3], joints, joints + 1e-3)


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
    assert ("NOT within" in outcomes.verdict(made)) is not passed


def test_a_run_that_did_not_get_to_its_last_look_has_not_passed() -> None:
    made = run(errors(1.0, 1.0, 1.0))
    assert not made.passed
    assert "look 2 was not reached; the last stage was: look 1" in outcomes.verdict(made)


def test_a_failed_look_is_a_dash_in_the_table_and_null_in_the_figures() -> None:
    made = run(errors(1.0, 1.0, 1.0), errors(1.0, -2.0, 3.0))
    table = outcomes.rows(made.stages)
    assert table[1][1:5] == ("–", "–", "–", "–")
    assert table[3][5:8] == ("+1.00", "-2.00", "+3.00")
    assert all(len(row) == len(outcomes.HEADINGS) for row in table)
    stages = outcomes.figures(made)["stages"]
    assert stages[1]["image"] is None
    assert stages[3]["true"]["y_mm"] == pytest.approx(-2.0)


def test_the_report_is_one_file_with_its_pictures_inside(tmp_path: Path, traces: plots.Traces) -> None:
    made = run(errors(1.0, 1.0, 1.0), errors(1.0, -2.0, 3.0))
    _, png = cv2.imencode(".png", np.full((72, 128, 3), 90, np.uint8))
    events = [{"t_ns": 5, "event": "<script>alert(1)</script>"}]
    path = write_report(tmp_path, made, traces, [Picture("before & after", png.tobytes())], events)
    html = path.read_text(encoding="utf-8")
    sources = re.findall(r'(?:src|href)="([^"]{0,30})', html)
    assert len(sources) == 5
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert "<script>" not in html
    assert outcomes.verdict(made).replace("'", "&#39;") in html
    assert "before &amp; after" in html
    assert json.loads((tmp_path / "figures.json").read_text())["passed"] is True
    assert json.loads((tmp_path / "events.jsonl").read_text()) == events[0]


def test_plots_are_pictures_with_something_on_them(traces: plots.Traces) -> None:
    stages = run(errors(9.0, 3.0, 1.0), errors(1.0, -2.0, 3.0)).stages
    drawn = [
        plots.path_plot(traces, stages),
        plots.error_plot(traces, stages),
        plots.joint_plot(traces, stages),
        plots.target_plot(stages),
    ]
    for png in drawn:
        image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        assert np.mean(image < 250) > 0.01


def test_two_runs_in_one_second_get_two_directories(tmp_path: Path) -> None:
    with run_directory(tmp_path / "runs") as first, run_directory(tmp_path / "runs") as second:
        assert first != second


def test_an_empty_run_directory_does_not_stay(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    with pytest.raises(KeyboardInterrupt), run_directory(runs):
        raise KeyboardInterrupt
    assert not runs.exists()
    with run_directory(runs) as directory:
        (directory / "report.html").write_text("kept")
    assert directory.is_dir()


def test_a_run_directory_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no directory")
    with pytest.raises(ConfigurationError) as told, run_directory(tmp_path / "file"):
        pass
    assert told.value.cause == "output.unwritable"
