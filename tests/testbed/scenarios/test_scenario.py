"""Scenarios: the same seed is the same world, draws do not disturb each other, mistakes are named."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from foundation.configuration import validated
from protocol.errors import ConfigurationError
from testbed.scenarios.scenario import Scenario, flattened, load_scenario, names

DRAWS = {
    "plant.payload_kg": {"kind": "uniform", "low": 0.0, "high": 100.0},
    "scene.mount.rotation_vector_deg": {"kind": "ball", "radius": 10.0},
    "plant.offsets_mrad": {"kind": "normal", "mean": [0.0] * 6, "std": [2.0] * 6},
    "scene.seed": {"kind": "seed"},
}


def scenario(draws: dict[str, object], **more: object) -> Scenario:
    return validated(Scenario, {"description": "a test", "draws": draws, **more}, "test")


def test_the_same_seed_is_the_same_world_and_two_seeds_differ() -> None:
    made = scenario(DRAWS)
    assert made.world(7) == made.world(7)
    for key in ("payload_kg", "offsets_mrad"):
        assert made.world(7)["plant"][key] != made.world(8)["plant"][key]


def test_draws_keep_their_bounds_and_fill_them() -> None:
    made = scenario(DRAWS)
    worlds = [made.world(seed) for seed in range(300)]
    payload = np.array([world["plant"]["payload_kg"] for world in worlds])
    assert payload.min() >= 0.0
    assert payload.max() <= 100.0
    assert payload.mean() == pytest.approx(50.0, abs=5.0)
    rotation = np.linalg.norm([world["scene"]["mount"]["rotation_vector_deg"] for world in worlds], axis=1)
    assert rotation.max() <= 10.0
    assert rotation.mean() == pytest.approx(5.0, abs=0.6)
    offsets = np.array([world["plant"]["offsets_mrad"] for world in worlds])
    assert np.abs(offsets).max() <= 6.0
    assert offsets.std() == pytest.approx(2.0, abs=0.15)


@given(
    st.floats(allow_nan=False, allow_infinity=False),
    st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=12),
    st.sampled_from(["plain", "yes", "1e-5", "a: b", "null", "", "# no comment"]),
)
def test_settings_read_back_exactly(number: float, many: list[float], text: str) -> None:
    settings = flattened(
        {"plant": {"a": {"number": number}, "many": many, "text": text}, "scene": {"flag": True}}
    )
    read = {key: yaml.safe_load(value) for key, value in (setting.split("=", 1) for setting in settings)}
    assert read == {"plant.a.number": number, "plant.many": many, "plant.text": text, "scene.flag": True}


@pytest.mark.parametrize(
    ("draw", "word"),
    [
        ({"kind": "uniform", "low": 2.0, "high": 1.0}, "low is above high"),
        ({"kind": "uniform", "low": [0.0], "high": [1.0, 2.0]}, "different length"),
        ({"kind": "poisson", "mean": 1.0}, "poisson"),
        ({"kind": "ball", "radius": -1.0}, "radius"),
    ],
)
def test_wrong_draws_are_refused_in_one_line(draw: dict[str, object], word: str) -> None:
    with pytest.raises(ConfigurationError, match=word) as caught:
        scenario({"plant.x": draw})
    assert "\n" not in str(caught.value)


def test_an_unknown_scenario_names_those_there_are(tmp_path: Path) -> None:
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "calm.yaml").write_text("description: nothing moves\n")
    assert names(tmp_path) == ["calm"]
    assert load_scenario(tmp_path, "calm").world(1) == {}
    with pytest.raises(ConfigurationError, match="known: calm") as caught:
        load_scenario(tmp_path, "storm")
    assert caught.value.cause == "configuration.unknown_scenario"
