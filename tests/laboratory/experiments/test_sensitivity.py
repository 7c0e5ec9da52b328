"""Sensitivity: the indices against known answers and scipy's; worlds mixed source by source; what is told."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import sobol_indices, uniform

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import perform
from laboratory.campaigns.rows import XYZ
from laboratory.experiments.positioning import mixed_worlds
from laboratory.experiments.positioning.mixed_worlds import (
    NOISE,
    OTHER,
    Runs,
    limited,
    mixed,
    sobol,
    source_of,
    sources_of,
)
from laboratory.experiments.positioning.sensitivity import (
    SENSITIVITY,
    SensitivityRow,
    SensitivitySettings,
    sensitivity_tasks,
)
from laboratory.experiments.positioning.worlds import WORLDS, WorldName
from tests.support.paths import CONFIGS

A_, B_ = 7.0, 0.1  # of Ishigami's function


def ishigami(x: Any) -> Any:
    """Of x (3, …), evenly in −π…π; its indices are known in closed form (Ishigami and Homma 1990)."""
    return np.sin(x[0]) + A_ * np.sin(x[1]) ** 2 + B_ * x[2] ** 4 * np.sin(x[0])


def known() -> tuple[list[float], list[float], float]:
    alone_1 = 0.5 * (1.0 + B_ * math.pi**4 / 5.0) ** 2
    alone_2 = A_**2 / 8.0
    together = 8.0 * B_**2 * math.pi**8 / 225.0
    variance = alone_1 + alone_2 + together
    first = [alone_1 / variance, alone_2 / variance, 0.0]
    return first, [first[0] + together / variance, first[1], together / variance], variance


def sampled(n: int, seed: int, numbers: Any = lambda y: y[:, None]) -> Runs:
    """Picked and frozen runs of Ishigami's function; ``numbers`` makes the m numbers of each."""
    rng = np.random.default_rng(seed)
    A, B = rng.uniform(-math.pi, math.pi, (2, 3, n))
    mixed_ = []
    for i in range(3):
        AB = A.copy()
        AB[i] = B[i]
        mixed_.append(numbers(ishigami(AB)))
    return Runs(numbers(ishigami(A)), numbers(ishigami(B)), np.array(mixed_))


def test_the_indices_of_a_known_function_are_found() -> None:
    first, total, variance = known()
    found = sobol(sampled(200_000, 1))
    np.testing.assert_allclose(found.first, first, atol=0.02)
    np.testing.assert_allclose(found.total, total, atol=0.02)
    assert found.variance == pytest.approx(variance, rel=0.02)


def test_they_are_scipy_s_where_scipy_has_them() -> None:
    runs = sampled(256, 2)
    told = {"f_A": runs.A.T, "f_B": runs.B.T, "f_AB": runs.AB.transpose(0, 2, 1)}
    theirs = sobol_indices(func=told, n=256, dists=[uniform()] * 3)
    ours = sobol(runs)
    np.testing.assert_allclose(ours.first, theirs.first_order, atol=1e-12)
    np.testing.assert_allclose(ours.total, theirs.total_order, atol=1e-12)


def test_intervals_hold_the_truth_as_often_as_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mixed_worlds, "_RESAMPLES", 200)
    _, total, _ = known()
    inside = []
    for seed in range(40):
        ends = limited(sampled(100, 1000 + seed), seed).total_ends
        inside += list((ends[0] <= total) & (total <= ends[1]))
    assert 0.85 <= np.mean(inside) <= 0.99  # of 120, each meant to be 95 %


@pytest.mark.parametrize("world", [WorldName.LAB, WorldName.REAL])
def test_a_mixed_world_has_one_source_of_the_other_and_all_else_of_its_own(world: WorldName) -> None:
    def world_of(seed: int, source: str) -> dict[str, Any]:
        return dict(mixed_worlds._leaves(mixed(CONFIGS, world, "plant", seed, source)))

    mine, other = world_of(1, "A"), world_of(1, "B")
    assert other == dict(mixed_worlds._drawn_leaves(CONFIGS, world, "plant", 1 + OTHER))
    names = sources_of(CONFIGS, world, "plant", 1)
    assert (len(names), names[-1]) == ((7, NOISE) if world is WorldName.LAB else (11, NOISE))
    for name in ("payload", "camera", NOISE):
        changed = world_of(1, name)
        moved = {key for key in mine if changed[key] != mine[key]}
        assert moved
        assert {source_of(key) for key in moved} == {name}
        assert all(changed[key] == other[key] for key in moved)
        assert moved == {key for key in mine if other[key] != mine[key] and source_of(key) == name}


def test_every_key_that_a_world_draws_belongs_to_a_source() -> None:
    for name in WORLDS:
        assert sources_of(CONFIGS, name, WORLDS[name].arm, 3)  # raises for a key of none


def row(seed: int, source: str, x: float) -> SensitivityRow:
    return SensitivityRow(seed, source, XYZ(x, -x, 0.0))


def machine(config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """A run in which the payload alone makes x, and y is always the same; one run fails."""
    other = OTHER if task["source"] in ("B", "payload") else 0
    x = float(np.random.default_rng(task["seed"] + other).uniform(0.0, 10.0))
    told = {"seed": task["seed"], "source": task["source"]}
    if task["key"] == "camera-4":
        return told | {"failure": "measurement.lost: gone"}
    return told | {"true_mm": XYZ(x, 3.0, 0.0)}


@pytest.mark.slow("whole runs of a campaign")
def test_the_command_names_what_limits_tells_the_cost_and_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    toy = SENSITIVITY.__class__(**{**vars(SENSITIVITY), "run": machine})
    for runs, reused in ((4, 0), (12, 36)):
        request = CampaignRequest(CONFIGS, tmp_path, runs=runs, seed=1, workers=0)
        assert perform(toy, request, SensitivitySettings()) is (runs == 12)
        told = " ".join(capsys.readouterr().out.split())
        assert f"{reused} rows reused" in told
    assert "12 samples of 9 runs: 108 runs, about 0.3 h of one core" in told
    assert "limited by │ payload" in told
    assert "samples left out for a failed run │ 1 of 12" in told
    page = (tmp_path / "sensitivity.html").read_text(encoding="utf-8")
    assert "samples left out for a failed run" in page
    assert len(sensitivity_tasks(request, SensitivitySettings())) == 108
