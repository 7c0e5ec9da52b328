"""Lockstep repeats: to the last bit on one machine, to a stated margin on every machine."""

import json

import numpy as np
import pytest

from tests.testbed.lockstep_recipes import PINNED, RECIPES, SEEDS, ran

pytestmark = pytest.mark.slow("two runs of a whole rig")

_QUICK = (("hand_eye", 1),)
_ALL = [(recipe, seed) for recipe in RECIPES for seed in SEEDS]
_ON_THE_WAY_M, _AT_THE_END_M = 10e-3, 2e-3
"""Three times what ten runs with inputs disturbed by 1e-9 were apart (stick and slip shift by an instant)."""


def compare(recipe: str, seed: int) -> None:
    first, again = ran(recipe, seed), ran(recipe, seed)
    assert first.digest == again.digest, "the same machine and libraries repeat to the last bit"
    pinned = np.array(json.loads(PINNED.read_text(encoding="utf-8"))[f"{recipe} {seed}"])
    found = np.array(first.tool_m)
    assert abs(len(found) - len(pinned)) <= 1, "it takes another time than it took"
    apart = [float(np.linalg.norm(a - b)) for a, b in zip(found[:-1], pinned[:-1], strict=False)]
    assert max(apart) < _ON_THE_WAY_M, f"{max(apart):.2e} m apart after {2 * int(np.argmax(apart))} s"
    assert np.linalg.norm(found[-1] - pinned[-1]) < _AT_THE_END_M


@pytest.mark.parametrize(("recipe", "seed"), _QUICK)
def test_a_run_repeats(recipe: str, seed: int) -> None:
    compare(recipe, seed)


@pytest.mark.experiment
@pytest.mark.parametrize(("recipe", "seed"), [run for run in _ALL if run not in _QUICK])
def test_every_recipe_repeats(recipe: str, seed: int) -> None:
    compare(recipe, seed)
