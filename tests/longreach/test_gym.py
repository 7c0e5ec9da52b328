"""The Gymnasium environment: what its own checker asks, lockstep, truth in info alone, a way to the goal."""

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import longreach
from longreach.gym import ArmEnv
from protocol.errors import ConfigurationError
from tests.support.paths import CONFIGS

TRUE = {"true_tool_m", "true_distance_m", "true_q", "payload_kg"}


def made(**options: Any) -> ArmEnv:
    return ArmEnv(config_dir=CONFIGS, **options)


def test_it_passes_gymnasium_s_checker_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(made(), skip_render_check=True)


def test_it_is_made_by_its_name() -> None:
    with gymnasium.make("longreach.gym:longreach/Arm-v0", config_dir=CONFIGS, limit_s=0.1) as env:
        env.reset(seed=1)
        ends = [env.step(np.zeros(6, np.float32))[3] for _ in range(5)]
    assert ends == [False] * 4 + [True]


def played(seed: int, scenario: str | None = None) -> list[Any]:
    env = made(scenario=scenario)
    observed, info = env.reset(seed=seed)
    rng = np.random.default_rng(7)
    steps = [*observed.values(), info["true_q"]]
    for _ in range(20):
        observed, reward, *_, info = env.step(rng.uniform(-0.5, 0.5, 6).astype(np.float32))
        steps += [*observed.values(), reward, info["true_q"]]
    return steps


def test_a_seed_is_a_world_to_the_last_bit() -> None:
    first, again, other = played(3), played(3), played(4)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_a_scenario_is_drawn_anew_for_each_seed() -> None:
    env = made(scenario="standard")
    loads = [env.reset(seed=seed)[1]["payload_kg"] for seed in (1, 2, 1)]
    assert loads[0] == loads[2] != loads[1]
    assert longreach.plant(scenario="standard", seed=1, config_dir=CONFIGS).truth.payload_kg == loads[0]


def test_truth_is_in_info_alone() -> None:
    bent = made(set={"plant.payload.mass_kg": 100, "plant.errors.encoder_offsets.mrad": [5.0] * 6})
    observed, info = bent.reset(seed=1, options={"goal": [3.5, 0.0, 1.2]})
    assert set(observed) == {"angles", "rates", "pressures", "supply", "tool", "goal"}
    assert set(info) >= TRUE
    believed = longreach.arm(config_dir=CONFIGS).fk(observed["angles"])[:3, 3]
    np.testing.assert_allclose(observed["tool"], believed, atol=1e-5)
    assert np.linalg.norm(info["true_tool_m"] - observed["tool"]) > 0.01  # bent, and read wrong
    away_m = float(np.linalg.norm(observed["tool"] - [3.5, 0.0, 1.2]))
    assert info["distance_m"] == pytest.approx(away_m, abs=1e-5)


def test_what_came_nearer_is_the_reward() -> None:
    env = made()
    observed, _ = env.reset(seed=2)
    above = observed["tool"] + np.array([0.0, 0.0, 0.5])
    begun_m = env.reset(seed=2, options={"goal": above})[1]["distance_m"]
    lift = np.array([0.0, 0.4, 0.0, 0.0, 0.0, 0.0], np.float32)
    steps = [env.step(lift) for _ in range(10)]
    rewards, left_m = sum(step[1] for step in steps), steps[-1][4]["distance_m"]
    assert rewards == pytest.approx(begun_m - left_m, abs=1e-9)
    assert rewards > 0.1


def test_it_ends_where_the_tool_rests_at_the_goal() -> None:
    env = made()
    observed, _ = env.reset(seed=2)
    for beside_m, arrives in ((0.0, True), (0.05, False)):
        goal = observed["tool"] + np.array([0.0, 0.0, beside_m])
        env.reset(seed=2, options={"goal": goal})
        assert env.step(np.zeros(6, np.float32))[2] is arrives


def test_a_step_that_is_no_number_of_cycles_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"step_s = 0.012: wanted a multiple of 0.005"):
        made(step_s=0.012)
