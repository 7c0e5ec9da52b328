"""The paper's tables beside ours: numbers as printed, means and verdicts right, failures never numbers."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from laboratory.campaigns.workforce import Task
from laboratory.experiments.paper import comparison, figures
from laboratory.experiments.paper.campaign import (
    PaperEyes,
    PaperSettings,
    comparison_cells,
    paper_task,
)
from laboratory.experiments.paper.comparison import compared, conclusions
from laboratory.experiments.paper.measurement import bench, measured_on
from laboratory.experiments.paper.sight import RememberingEyes, traced_arrays
from protocol.errors import MeasurementFailed
from testbed.lockstep.clock import run

pytestmark = pytest.mark.slow("whole runs of a campaign")

CONFIGS = Path("configs")
OPENCV = PaperSettings()


def task(kind: str, seed: int, eyes: PaperEyes) -> Task:
    return paper_task(CONFIGS, OPENCV._replace(eyes=eyes), kind, seed)


def line_row(seed: int, x: float, y: float, *, second: float = 30.0, turn: float = 1.5) -> dict[str, Any]:
    row: dict[str, Any] = {"seed": seed, "failure": None, "run_s": 10.0, "cpu_s": 8.0}
    for axis, value, after in zip("xyz", (x, y, 340.0), (second, second, 340.0), strict=True):
        row |= {f"input1_{axis}_mm": value, f"input2_{axis}_mm": after, f"oriented_r{axis}_deg": -turn}
    return row


def match_row(seed: int, residual: float, first: float, second: float) -> dict[str, Any]:
    row: dict[str, Any] = {
        "seed": seed,
        "failure": None,
    }
    for axis in "xyz":
        row |= {f"residual_{axis}_mm": residual, f"residual_max_{axis}_mm": 2 * residual}
        row |= {f"input1_{axis}_mm": first, f"input2_{axis}_mm": -second}
    return row


def test_figures_are_compared_by_their_means_of_absolute_values() -> None:
    rows = [line_row(1, 40.0, -70.0), line_row(2, -20.0, 60.0), {"seed": 3, "failure": "measurement.x: y"}]
    beside = compared("table2", rows)
    x, y, z = beside[3:]
    assert (x.runs, x.mean, x.ratio) == (2, 30.0, 30.0 / 24.0)
    assert (x.judged, x.reached) == (True, True)
    assert x.std == pytest.approx(10.0 * math.sqrt(2.0))
    assert comparison_cells(beside)[3][2:4] == ["24 ± 16", "30.0 ± 14.1"]
    assert (y.judged, y.reached) == (True, False)  # 65 against 29
    assert not z.judged
    cells = comparison_cells(beside)
    assert cells[3][-1] == "within 2"
    assert cells[4][-1] == "OUTSIDE 2"


def test_nothing_measured_is_outside_and_not_a_zero() -> None:
    (first, *_) = compared("table4", [{"seed": 1, "failure": "measurement.odometry_lost: x"}])
    assert first.runs == 0
    assert math.isnan(first.mean)
    assert not first.reached


def test_the_line_equations_conclusions_hold_only_when_they_do() -> None:
    unreliable = [line_row(seed, 30.0 * (seed % 3), 12.0) for seed in range(9)]
    assert [c.met for c in conclusions("table2", unreliable)] == [True, True, True]
    precise = [line_row(seed, 3.0, 4.0, second=1.0, turn=5.0) for seed in range(9)]
    assert [c.met for c in conclusions("table2", precise)] == [False, False, False]


def test_a_run_that_did_not_get_there_is_not_under_a_centimetre() -> None:
    rows = [match_row(seed, 1.0 + seed, 20.0, 2.0) for seed in range(5)]
    every, single = conclusions("table4", rows)
    assert every.met
    assert single.met
    every, _ = conclusions("table4", [*rows, {"seed": 9, "failure": "measurement.odometry_lost: x"}])
    assert not every.met
    assert "5 of 6" in every.found


def test_the_papers_eyes_see_what_is_there_but_worse_than_ours() -> None:
    looks = {}
    for eyes in (PaperEyes.OPENCV, PaperEyes.PIXELS):
        rig = bench(CONFIGS, task("line", 3, eyes=eyes))
        look = run(rig.eyes.look(2))
        true = rig.world.truths[-1]
        seen = look.X_CO[:3, 3] - look.X_CM[:3, 3]
        looks[eyes] = float(np.linalg.norm(seen - (true.p_CO - true.p_CM)))
    assert looks["pixels"] < 0.004
    assert looks["pixels"] < looks["opencv"] < 0.05


def test_a_traced_measurement_notes_inputs_and_pictures() -> None:
    rig = bench(CONFIGS, task("line", 3, eyes=PaperEyes.MODEL), traces=True)
    row, match = measured_on(rig, "line")
    traced = traced_arrays(rig.arm, rig.eyes, match)
    assert len(traced["input_s"]) == 4  # orientation, circle, two inputs
    assert traced["corners_1"].shape == (19, 3)
    assert len(traced["look_s"]) == 4  # before and after the orientation, and after each input
    assert np.isfinite(traced["error_m"]).all(axis=1).mean() > 0.9
    assert row["input1_x_mm"] == pytest.approx(1e3 * traced["look_error_m"][-2][0])
    assert comparison.worst_mm([row], "input1") < 60.0
    for name in ("fig5", "fig6", "fig7"):
        assert len(figures.draw(name, traced).axes[0].lines) >= 3


class BlinkingEyes:
    """Eyes that fail for ``causes`` in turn before they see."""

    def __init__(self, *causes: str) -> None:
        self._causes = list(causes)

    async def look(self, frames: int | None = None) -> Any:
        if self._causes:
            raise MeasurementFailed(self._causes.pop(0), "look")
        return "seen"


def test_a_failed_sample_is_looked_at_again_and_any_other_failure_is_not_hidden() -> None:
    eyes = RememberingEyes(BlinkingEyes("measurement.tool_not_seen", "measurement.object_not_seen"))  # type: ignore[arg-type]
    assert run(eyes.look()) == "seen"
    assert (eyes.unseen, eyes.looks) == (2, ["seen"])
    for causes in (["measurement.tool_not_seen"] * 5, ["measurement.no_frames"]):
        with pytest.raises(MeasurementFailed) as failed:
            run(RememberingEyes(BlinkingEyes(*causes)).look())  # type: ignore[arg-type]
        assert failed.value.cause == causes[-1]
