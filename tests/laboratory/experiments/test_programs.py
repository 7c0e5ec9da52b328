"""Counting runs: a run that failed counts as a miss, never as a zero."""

import numpy as np

from laboratory.experiments.positioning.programs import row_of, worst_after
from testbed.reporting.outcome import Errors, Outcome, Stage


def outcome(seed: int, *after_looks_mm: tuple[float, float]) -> Outcome:
    stages = [Stage("start", 0, 1.0, None, Errors(np.array([0.3, 0.1, 0.5]), 0.1))]
    for number, (x, y) in enumerate(after_looks_mm, 1):
        p = np.array([x, y, 40.0]) / 1e3
        stages.append(Stage(f"look {number}", number, 2.0, Errors(p, 0.0), Errors(p, 0.0)))
    return Outcome("lockstep", "standard", seed, 2, tuple(stages), 10.0, 60.0, {"event_log_sha256": "aa"})


def test_errors_are_of_the_worse_axis_and_a_run_that_stopped_is_never_inside() -> None:
    rows = [
        row_of(outcome(1, (9.0, 0.0), (4.0, 1.0))),
        row_of(outcome(2, (4.0, -11.0), (0.0, 7.0))),
        row_of(outcome(3, (3.0, 3.0))),
        {"failure": "campaign.exception: a bug"},
    ]
    assert worst_after(rows, 1).tolist() == [9.0, 11.0, 3.0, np.inf]
    assert worst_after(rows, 2).tolist() == [4.0, 7.0, np.inf, np.inf]
