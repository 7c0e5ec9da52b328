"""The project's headline figures with a few runs each, near enough to the claims that a doubled error fails.

The campaigns behind the claims are in `longreach experiment …`; these are single runs of them, with seeds.
Lockstep repeats bit by bit, so a figure moves only when the code or the configuration does.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from laboratory.experiments.hand_eye.stress import BAD_SAMPLES, attempted, rows_of
from laboratory.experiments.paper.campaign import PaperEyes, PaperSettings, paper_task
from laboratory.experiments.paper.measurement import measure
from laboratory.experiments.positioning.corrected_run import true_error_mm
from testbed.lockstep.rig import LockstepRig
from tests.support.paths import CONFIGS
from tests.testbed.lockstep_recipes import corrected, demonstration
from vision_pc.config.choices import Method

pytestmark = pytest.mark.slow("whole runs of a campaign")


def median_mm(drive: Callable[[str, int], LockstepRig], which: str) -> float:
    """The median of four true errors in mm after a drive."""
    return float(np.median([np.abs(true_error_mm(drive(which, seed))[:2]).max() for seed in range(1, 5)]))


def of_the_paper(seeds: tuple[int, ...]) -> float:
    """The worse of the mean |x| and |y| in mm after two inputs of trajectory matching, as the eyes see it."""
    eyes = PaperSettings(eyes=PaperEyes.MODEL)
    rows = [measure(CONFIGS, paper_task(CONFIGS, eyes, "match", seed)) for seed in seeds]
    return float(max(np.mean([abs(row[f"input2_{axis}_mm"]) for row in rows]) for axis in "xy"))


def robust() -> tuple[float, float]:
    """Median errors of the robust solver, degrees and mm, with 2 of 15 samples bad."""
    (row,) = rows_of(BAD_SAMPLES, attempted(BAD_SAMPLES, range(20), 1, [Method.ROBUST]))
    return row.rotation_median_deg, row.translation_median_mm


# Each figure, its limit, and the claim that the limit guards.
@pytest.mark.parametrize(
    ("measured", "limits"),
    [
        pytest.param(partial(median_mm, corrected, "plant"), (0.6,), id="one look, 4 m arm"),  # median: 0.6
        pytest.param(
            partial(median_mm, corrected, "plant_long_crane"), (0.8,), id="one look, crane"
        ),  # median 0.4
        pytest.param(
            partial(median_mm, demonstration, "standard"), (3.0,), id="demonstration, look 1"
        ),  # median 2.6
        pytest.param(partial(of_the_paper, (1, 2)), (7.0,), id="paper, second input"),  # all below 10 mm
        pytest.param(robust, (0.15, 2.2), id="hand-eye, 2 of 15 bad"),  # 0.08 degrees, 1.3 mm
    ],
)
def test_a_headline_figure_is_within_its_claim_and_doubled_it_would_not_be(
    measured: Callable[[], float | tuple[float, ...]], limits: tuple[float, ...]
) -> None:
    errors = np.atleast_1d(measured())
    assert np.all(errors < limits)
    assert np.all(2.0 * errors > limits), "the limit has become too wide to notice a doubled error: lower it"
