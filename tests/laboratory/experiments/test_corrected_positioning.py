"""Corrected positioning's campaign: what it draws, what it counts, and that its verdict can fail."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Finished
from laboratory.campaigns.rows import flat, typed
from laboratory.experiments.positioning.corrected import (
    BOTH_ARMS,
    DrawnSettings,
    errors_plot,
    positioning_table,
    positioning_tasks,
)
from laboratory.experiments.positioning.corrected_run import PositioningRow, prediction_of
from laboratory.experiments.positioning.results import (
    chance_band,
    checks_of,
    covered,
    nees,
    overconfident_failures,
    predictions,
    reliability,
    reliability_plot,
    share,
    worst_mm,
    worst_ratio,
)
from laboratory.experiments.positioning.scenarios import draw
from laboratory.experiments.positioning.worlds import ARMS, WORLDS, WorldName
from plant_emulator.core.camera.camera_motion import CameraView, Capture
from plant_emulator.core.camera.scene import Scene
from protocol.errors import ConfigurationError
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


def test_the_harder_ones_differ_in_what_best_mode_names() -> None:
    usual, harder = (draw(CONFIGS, 7, "plant", world).overrides for world in (LAB, WORLDS[WorldName.HARDER]))
    assert harder["scene"]["camera"]["baseline_m"] != 0.12
    assert abs(harder["scene"]["camera"]["baseline_m"] / 0.12 - 1.0) <= 0.006
    assert "baseline_m" not in usual["scene"]["camera"]
    assert harder["plant"]["errors"]["backlash"]["half_width_mrad"][0] == 0.5


def test_an_unknown_arm_is_refused_by_name() -> None:
    with pytest.raises(ConfigurationError, match="knuckle"):
        draw(CONFIGS, 1, "knuckle", LAB)


def test_both_arms_take_turns() -> None:
    request = CampaignRequest(CONFIGS, Path("unused"), runs=4)
    tasks = positioning_tasks(request, DrawnSettings(arm=BOTH_ARMS))
    assert {task["arm"] for task in tasks} == set(ARMS)
    assert len({task["key"] for task in tasks}) == 4


def row(error: float, std: float = 1.0, **changes: Any) -> PositioningRow:
    made: dict[str, Any] = {}
    end = expected_end(np.zeros(3), (1e-3 * std) ** 2 * np.eye(3), 0.005)
    for name in ("one_shot", "look1", "look2"):
        made[f"{name}_worst_mm"] = abs(error)
        for axis in "xy":
            made |= {f"{name}_true_{axis}_mm": error, f"{name}_std_{axis}_mm": std}
            made |= {f"{name}_servo_{axis}_mm": 0.4}
        for when in ("before", "after"):
            made |= flat({f"{name}_{when}": prediction_of(end, np.full(3, error))})
    return typed(PositioningRow, made | changes)


def failed(failure: str) -> PositioningRow:
    return typed(PositioningRow, {"seed": 1, "failure": failure})


def test_a_run_that_failed_counts_as_failed_and_never_as_zero() -> None:
    rows = [row(0.5)] * 99 + [failed("measurement.tool_not_seen: x")]
    assert share(worst_mm(rows, "look1"), 5.0) == pytest.approx(0.99)
    rows += [row(0.5, look1_worst_mm=None, look1_failure="measurement.ill_conditioned: y")] * 3
    found = {check.what: check for check in checks_of(rows, LAB.demands)}
    assert found["one look: share within 5 mm"].found == f"{99 / 103:.3f}"
    assert found["one look: share within 5 mm"].met is False


def test_the_verdict_fails_where_a_figure_is_outside_and_only_there() -> None:
    good = [row((2.0 if k % 20 == 0 else 0.918) * (-1.0) ** k) for k in range(200)]  # 95 % in the ellipse
    assert [check.what for check in checks_of(good, LAB.demands) if check.met is False] == []
    vain = [row(4.0 * r.look1.true_mm.x) for r in good]  # told as before
    missed = {check.what for check in checks_of(vain, LAB.demands) if check.met is False}
    assert "one look: error² over predicted variance, mean" in missed
    assert "two looks: 95 %" in missed
    relaxed = {
        check.what for check in checks_of(vain, WORLDS[WorldName.HARDER].demands) if check.met is False
    }
    assert "two looks: 95 %" not in relaxed


def test_the_tables_tell_what_the_world_draws_and_how_many_draws_were_not_kept() -> None:
    rows = [row(0.5, unreachable=3, unseen=1), row(0.5, unreachable=0, unseen=3)]
    request = CampaignRequest(CONFIGS, Path("unused"), runs=2)
    settings = DrawnSettings(WorldName.HARDER)
    axes, *_, kept = positioning_table(Finished(request, settings, [], rows, 0))
    assert [len(table.columns) for table in (axes, kept)] == [3, 5]
    assert axes.row_count == len(WORLDS[WorldName.HARDER].axes)
    assert [list(column.cells) for column in kept.columns] == [["9"], ["3"], ["4"], ["2"], ["33%"]]


def test_the_share_inside_the_ellipse_counts_runs_that_ended() -> None:
    rows = [row(0.5)] * 19 + [row(2.0), row(0.5, look1_before_distance2=None)]
    assert covered(predictions(rows, "look1", "before")) == pytest.approx(0.95)


def test_an_overcautious_prediction_is_no_honest_one_either() -> None:
    rng = np.random.default_rng(2)
    rows = [row(float(e), std=3.0) for e in rng.normal(size=200)]
    value, (low, high) = nees(predictions(rows, "look1", "before")), chance_band(200)
    assert value < low < 1.0 < high
    missed = {check.what for check in checks_of(rows, LAB.demands) if check.met is False}
    assert "one look: error² over predicted variance, mean" in missed


def test_a_failure_is_overconfident_where_it_was_predicted_to_be_unlikely() -> None:
    surprised, warned, good = row(6.0, std=1.0), row(6.0, std=6.0), row(1.0, std=1.0)
    rows = [surprised, warned, good, failed("measurement.odometry_lost: z")]
    before = predictions(rows, "look1", "before")
    assert before[0].probability > 0.99
    assert before[1].probability < 0.5
    assert overconfident_failures(before, worst_mm(rows, "look1")) == 1
    assert worst_ratio(rows, "look1") == pytest.approx(6.0)
    untold = [row(6.0, look1_before_probability=None)]
    assert overconfident_failures(predictions(untold, "look1", "before"), worst_mm(untold, "look1")) == 1, (
        "nobody was warned"
    )
    found = {check.what: check for check in checks_of(rows, LAB.demands)}
    assert found["one look: overconfident failures"].met is False
    assert {check.what: check for check in checks_of([good], LAB.demands)}[
        "one look: overconfident failures"
    ].met


def test_the_reliability_counts_by_what_was_predicted() -> None:
    rows = [row(1.0, std=1.0)] * 3 + [row(6.0, std=6.0), row(3.0, std=6.0)]
    bins = reliability(predictions(rows, "look1", "before"), worst_mm(rows, "look1"))
    assert [(count, share) for _, _, count, _, share in bins] == [(2, 0.5), (3, 1.0)]
    figure = reliability_plot(
        {"all": (predictions(rows, "look1", "before"), worst_mm(rows, "look1"))}, "title"
    )
    assert [len(line.get_xdata()) for line in figure.axes[0].lines] == [2, 2]  # the diagonal, and two bins


def test_the_picture_counts_runs_that_failed() -> None:
    rows = [row(1.0 + k) for k in range(3)]
    figure = errors_plot({"plant": rows, "plant_long_crane": [failed("why")]}, "title")
    ends = [[line.get_ydata()[-1] for line in axes.lines] for axes in figure.axes]
    assert ends == [[100.0] * 3, [0.0] * 3]


def test_what_all_drives_end_off_alike_is_not_how_differently_they_end() -> None:
    def ended(off_mm: float) -> PositioningRow:
        names = [f"{name}_servo_{axis}_mm" for name in ("one_shot", "look1", "look2") for axis in "xyz"]
        return row(0.5, **dict.fromkeys(names, 0.8 + off_mm))

    rows = [ended(off_mm) for off_mm in (-0.3, 0.0, 0.3)] + [failed("measurement.tool_not_seen: x")]
    found = {check.what: check for check in checks_of(rows, LAB.demands)}
    assert found["how differently drives end, 1 σ an axis"].found == "0.300 mm"
    assert not any("differently" in check.what for check in checks_of(rows[:1], LAB.demands))
