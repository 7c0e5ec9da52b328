"""Pictures against the eye model, in pairs: few or scattered runs show nothing, and stopped runs count."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testbed.campaigns.campaign import CampaignRequest
from testbed.campaigns.options import EyesKind
from testbed.campaigns.typed_rows import typed
from testbed.experiments.positioning.eyes_agree import (
    AgreeSettings,
    EyesRow,
    Pairs,
    agree_tasks,
    compare,
    paired,
)
from testbed.experiments.positioning.worlds import WorldName
from tests.support.paths import CONFIGS

RNG = np.random.default_rng(3)
WORLDS = RNG.lognormal(0.0, 0.6, 30)  # what both eyes share: a hard world is hard with either


def pairs(factor: float, n: int = 30, stopped: tuple[int, int] = (0, 0)) -> Pairs:
    own = np.random.default_rng(5).lognormal(0.0, 0.3, (2, 30))
    return Pairs(factor * WORLDS[:n] * own[0, :n], WORLDS[:n] * own[1, :n], *stopped)


def test_many_like_pairs_agree_and_a_factor_is_seen() -> None:
    assert compare(pairs(1.0)).agree
    assert not compare(pairs(1.6)).agree
    assert not compare(pairs(0.6)).agree, "a model that is too hard is no stand-in either"


def test_few_pairs_show_nothing_and_say_how_little() -> None:
    few, many = compare(pairs(1.0, 5)), compare(pairs(1.0))
    assert not few.agree, "no difference found is not agreement"
    assert few.seen > many.seen > 1.0
    assert np.isnan(compare(pairs(1.0, 3)).ratio)
    assert not compare(pairs(1.0, 3)).agree


def test_the_power_told_is_the_power_there_is() -> None:
    rng, seen, found, n = np.random.default_rng(7), [], 0, 20
    for _ in range(400):
        one, other = rng.lognormal(0.0, 0.4, (2, n))
        seen.append(compare(Pairs(one, other, 0, 0)).seen)
    factor = float(np.median(seen))
    for _ in range(400):
        one, other = rng.lognormal(0.0, 0.4, (2, n))
        logs = np.log(factor * one / other)
        found += abs(logs.mean()) > 2.093 * logs.std(ddof=1) / np.sqrt(n)  # t of 19 degrees of freedom
    assert found / 400 == pytest.approx(0.8, abs=0.06)


def test_runs_that_stop_with_one_eye_only_are_no_agreement() -> None:
    assert compare(pairs(1.0, 20, stopped=(2, 1))).agree
    assert not compare(pairs(1.0, 20, stopped=(9, 0))).agree


def row(seed: int, eyes: str, error: float | None, arm: str = "plant") -> EyesRow:
    made: dict[str, Any] = {"seed": seed, "arm": arm, "eyes": eyes, "look1_worst_mm": error}
    if error is not None:
        made |= {f"look1_{what}_{axis}_mm": error for what in ("true",) for axis in "xy"}
        made |= {f"look1_measured_{axis}_mm": error + 0.3 for axis in "xy"}
    return typed(EyesRow, made)


def test_pairs_are_of_one_seed_and_arm_and_a_stopped_run_is_counted_once() -> None:
    rows = [row(1, "pixels", 1.0), row(1, "model", 2.0), row(2, "pixels", None), row(2, "model", 2.0)]
    rows += [row(1, "pixels", 3.0, "plant_long_crane"), row(3, "model", 9.0)]
    error, odometry = paired(rows, "look1")
    assert (error.pixels.tolist(), error.model.tolist()) == ([1.0], [2.0])
    assert (error.pixels_stopped, error.model_stopped) == (1, 0)
    assert odometry.pixels[0] == pytest.approx(0.3 * 2**0.5)


def test_a_campaign_runs_pair_after_pair_on_machines_as_they_were_asked_for() -> None:
    request = CampaignRequest(CONFIGS, Path("nowhere"), runs=2, seed=8)
    tasks = agree_tasks(request, AgreeSettings(WorldName.REAL, adapting=True, commissioned=True))
    assert [(task["seed"], task["eyes"]) for task in tasks] == [
        *((8, eyes) for eyes in EyesKind),
        *((9, eyes) for eyes in EyesKind),
    ]
    for task in tasks:
        assert (task["world"], task["adapting"], task["commissioned"]) == ("real", True, True)
    assert "adapting" not in agree_tasks(request, AgreeSettings())[0]
