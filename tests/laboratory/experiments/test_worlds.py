"""The worlds that machines are drawn from: named, wide, different, and told to nobody."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from foundation.configuration import merged
from laboratory.experiments.positioning.axes import Axis
from laboratory.experiments.positioning.scenarios import draw
from laboratory.experiments.positioning.worlds import ARMS, WORLDS, DrawnWorld, WorldName
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.plant import Plant
from testbed.scenarios.arms import arm_overrides
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS

pytestmark = pytest.mark.slow("whole runs of a campaign")

AXES = {axis.name: axis for world in WORLDS.values() for axis in world.axes}


def usual(arm: str = "plant") -> Any:
    return load_settings(CONFIGS, arm_overrides(CONFIGS, arm))


def leaves(overrides: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in overrides.items():
        below = leaves(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
        found |= below
    return found


@pytest.mark.parametrize("axis", AXES.values(), ids=lambda axis: axis.name)
def test_an_axis_changes_the_truth_alone_and_is_what_the_plant_takes(axis: Axis) -> None:
    for arm in ARMS:
        base = usual(arm)
        for seed in range(3):
            made = axis.draw(np.random.default_rng(seed), base)
            assert set(made) <= {"plant", "scene"}, "neither controller nor vision is told"
            load_settings(CONFIGS, merged(arm_overrides(CONFIGS, arm), made))
            assert leaves(made) == leaves(axis.draw(np.random.default_rng(seed), base))
    assert axis.width
    assert "[S]" in axis.source or "[E]" in axis.source


@pytest.mark.parametrize("axis", AXES.values(), ids=lambda axis: axis.name)
def test_an_axis_that_says_it_is_drawn_differs_from_seed_to_seed_and_from_the_usual(axis: Axis) -> None:
    base = usual()
    first, second = (axis.draw(np.random.default_rng(seed), base) for seed in (1, 2))
    assert (leaves(first) == leaves(second)) is axis.width.endswith("not drawn")
    plain = leaves({"plant": base.plant.model_dump(mode="json"), "scene": base.scene.model_dump(mode="json")})
    assert any(plain.get(key) != value for key, value in leaves(first).items())


@pytest.mark.parametrize("name", [WorldName.REAL, WorldName.CRANE_REAL])
def test_the_plant_can_be_stepped_as_it_was_drawn(name: WorldName) -> None:
    for seed in range(31, 37):
        settings = load_settings(CONFIGS, draw(CONFIGS, seed, WORLDS[name].arm, WORLDS[name]).overrides)
        Plant(settings.plant, seed, Scene(settings.scene).mounts)  # refuses a step that is too long


@pytest.mark.parametrize("name", [WorldName.REAL, WorldName.CRANE_REAL])
def test_a_real_world_has_every_axis_in_it(name: WorldName) -> None:
    world: DrawnWorld = WORLDS[name]
    made = draw(CONFIGS, 11, world.arm, world)
    assert made == draw(CONFIGS, 11, world.arm, world)
    changed = leaves(made.overrides)
    for axis in world.axes:
        beside = leaves(axis.draw(np.random.default_rng(0), usual(world.arm)))
        assert beside.keys() <= changed.keys(), axis.name
    assert abs(made.shown["disparity_px"]) <= 3.5
