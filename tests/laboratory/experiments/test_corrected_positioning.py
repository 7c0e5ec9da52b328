"""Corrected positioning's campaign: what it draws, what it counts, and that its verdict can fail."""

from typing import Any

import numpy as np
import pytest

from laboratory.experiments.positioning.corrected_run import named, prediction_of
from laboratory.experiments.positioning.results import (
    chance_band,
    checks_of,
    nees,
    overconfident_failures,
    share,
    worst_mm,
)
from laboratory.experiments.positioning.scenarios import draw
from laboratory.experiments.positioning.worlds import ARMS, WORLDS, WorldName
from plant_emulator.core.camera.exposures import CameraView, Capture
from plant_emulator.core.camera.scene import Scene
from testbed.lockstep.true_view import TrueView
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS
from vision_pc.core.positioning.expected_end import expected_end

pytestmark = pytest.mark.slow("whole runs of a campaign")

LAB = WORLDS[WorldName.LAB]


@pytest.mark.parametrize("arm", ARMS)
def test_scenarios_are_as_wide_as_the_page_says_and_can_be_done(arm: str) -> None:
    for seed in (7, 8):
        drawn = draw(CONFIGS, seed, arm, LAB)
        assert drawn == draw(CONFIGS, seed, arm, LAB)
        assert 0.0 <= drawn.shown["payload_kg"] <= 150.0
        assert drawn.shown["mount_deg"] <= 20.0
        assert drawn.shown["lever_m"] <= 0.5
        assert 0.3 <= drawn.shown["distance_m"] <= 1.2
        assert abs(drawn.shown["disparity_px"]) <= 0.5
        settings = load_settings(CONFIGS, drawn.overrides)
        scene = Scene(settings.scene)
        assert settings.plant.geometry.telescope_m == (3.0 if arm == "plant_long_crane" else 1.0)
        assert settings.arm.dh[3].d_m == pytest.approx(
            settings.plant.geometry.boom_tip_m[0] + settings.plant.geometry.telescope_m
        ), "the controller's nominal arm must be the plant's"
        assert (
            len(
                TrueView(settings.scene.camera, scene).markers(
                    Capture(0, 0, CameraView(np.eye(4), np.eye(4)))
                )
            )
            == 4
        )


def row(error: float, std: float = 1.0, **changes: Any) -> dict[str, Any]:
    made: dict[str, Any] = {}
    end = expected_end(np.zeros(3), (1e-3 * std) ** 2 * np.eye(3), 0.005)
    for name in ("one_shot", "look1", "look2"):
        made |= {f"{name}_worst_mm": abs(error), f"{name}_true_x_mm": error}
        for when in ("before", "first", "last"):
            made |= named(f"{name}_{when}", prediction_of(end, np.full(3, error)))
    return made | changes


FAILED = {"seed": 1, "failure": "measurement.tool_not_seen: x"}


def missed(rows: list[dict[str, Any]]) -> set[str]:
    return {check.what for check in checks_of(rows, LAB.demands) if check.met is False}


def test_a_run_that_failed_counts_as_failed_and_never_as_zero() -> None:
    rows = [row(0.5)] * 99 + [FAILED]
    assert share(worst_mm(rows, "look1"), 5.0) == pytest.approx(0.99)
    rows += [row(0.5, look1_worst_mm=None, look1_failure="measurement.ill_conditioned: y")] * 3
    found = {check.what: check for check in checks_of(rows, LAB.demands)}
    assert found["one look: share within 5 mm"].found == f"{99 / 103:.3f}"
    assert found["one look: share within 5 mm"].met is False


def test_the_verdict_fails_where_a_figure_is_outside_and_only_there() -> None:
    good = [row((2.0 if k % 20 == 0 else 0.918) * (-1.0) ** k) for k in range(200)]  # 95 % in the ellipse
    assert missed(good) == set()
    vain = missed([row(4.0 * r["look1_true_x_mm"]) for r in good])  # told as before
    assert "one look: error² over predicted variance, mean" in vain
    assert {"two looks: 95 %", "a look at the start: error² over predicted variance, mean"} <= vain


def test_an_overcautious_prediction_is_no_honest_one_either() -> None:
    rows = [row(float(e), std=3.0) for e in np.random.default_rng(2).normal(size=200)]
    low, high = chance_band(400)
    assert nees(rows, "look1_before") < low < 1.0 < high
    assert "one look: error² over predicted variance, mean" in missed(rows)


def test_a_failure_is_overconfident_where_it_was_predicted_to_be_unlikely() -> None:
    surprised, warned, good = row(6.0, std=1.0), row(6.0, std=6.0), row(1.0, std=1.0)
    assert surprised["look1_before_probability"] > 0.99
    assert warned["look1_before_probability"] < 0.5
    rows = [surprised, warned, good, FAILED]
    assert overconfident_failures(rows, "look1_before") == 1
    untold = [row(6.0, look1_before_probability=None)]
    assert overconfident_failures(untold, "look1_before") == 1, "nobody was warned"
    assert "one look: overconfident failures" in missed(rows)
    assert "one look: overconfident failures" not in missed([good])
