"""Counting runs: a run that failed counts as a miss, never as a zero."""

import math

import numpy as np

from testbed.campaigns.typed_rows import typed
from testbed.experiments.positioning.lockstep_demo import DemoRow, counts, row_of
from testbed.reporting.outcome import Errors, Outcome, Stage


def outcome(seed: int, *after_looks_mm: tuple[float, float]) -> Outcome:
    stages = [Stage("start", 0, 1.0, None, Errors(np.array([0.3, 0.1, 0.5]), 0.1))]
    for number, (x, y) in enumerate(after_looks_mm, 1):
        p = np.array([x, y, 40.0]) / 1e3
        stages.append(Stage(f"look {number}", number, 2.0, Errors(p, 0.0), Errors(p, 0.0)))
    return Outcome("lockstep", "standard", seed, 2, tuple(stages), 10.0, 60.0, {"event_log_sha256": "aa"})


def test_rows_tell_what_was_drawn_and_where_it_ended() -> None:
    world = {"plant": {"payload": {"mass_kg": 42.0}}, "scene": {"mount": {"rotation_deg": [3.0, 0.0, 4.0]}}}
    row = row_of(outcome(7, (8.0, -6.0), (1.0, -2.0)), world)
    assert (row["seed"], row["payload_kg"], row["mount_deg"]) == (7, 42.0, 5.0)
    assert row["look1_worst_mm"] == 8.0
    assert row["look2_true_y_mm"] == -2.0


def test_counts_are_by_the_worse_axis_and_a_run_that_stopped_counts_as_missed() -> None:
    rows = [
        typed(DemoRow, row_of(made, {}))
        for made in (
            outcome(1, (9.0, 0.0), (4.0, 1.0)),
            outcome(2, (4.0, -11.0), (0.0, 7.0)),
            outcome(3, (3.0, 3.0)),
        )
    ]
    first, second = counts(rows, 2)
    assert (first.under_10_mm, first.under_5_mm, first.not_reached) == (2, 1, 0)
    assert (second.under_10_mm, second.under_5_mm, second.not_reached) == (2, 1, 1)
    assert second.median_mm == 5.5
    assert math.isnan(counts([rows[2]], 2)[1].median_mm)
