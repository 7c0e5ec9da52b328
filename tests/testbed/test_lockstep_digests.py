"""Lockstep repeats to the last bit over changes of the code: event logs against pinned digests.

On another processor or with other libraries the last bits may differ; there the number of events and the
place where the tool truly ended must agree.
"""

import json

import numpy as np
import pytest

from tests.testbed.lockstep_digests import PINNED, RECIPES, SEEDS, machine, ran

pytestmark = pytest.mark.slow("whole runs in lockstep")

_QUICK = (("hand_eye", 1), ("servoing", 1))
_ALL = [(recipe, seed) for recipe in RECIPES for seed in SEEDS]
_ELSEWHERE_M = 1e-3  # the servo's own repeatability; a changed law or a changed world is farther off


def compare(recipe: str, seed: int) -> None:
    pinned = json.loads(PINNED.read_text(encoding="utf-8"))
    wanted, found = pinned["runs"][f"{recipe} {seed}"], ran(recipe, seed)
    assert found.events == wanted["events"]
    assert np.abs(np.array(found.tool_m) - wanted["tool_m"]).max() < _ELSEWHERE_M
    if pinned["machine"] == machine():
        assert found.digest == wanted["digest"]


@pytest.mark.parametrize(("recipe", "seed"), _QUICK)
def test_a_run_repeats_the_pinned_event_log(recipe: str, seed: int) -> None:
    compare(recipe, seed)


@pytest.mark.experiment
@pytest.mark.parametrize(("recipe", "seed"), [run for run in _ALL if run not in _QUICK])
def test_every_recipe_repeats_its_pinned_event_log(recipe: str, seed: int) -> None:
    compare(recipe, seed)
