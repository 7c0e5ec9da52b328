"""Runs in lockstep that change when behaviour changes: what they did is pinned, rounded, for every machine.

Each recipe drives one world for a while: the demonstration with pictures, the corrected positioning on the
crane and visual servoing with the eye model, and a guided hand-eye session with pictures.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from laboratory.experiments.positioning.corrected_run import operate, prepared
from testbed.demonstration.sequence import Recorder, demonstrate
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.world import TRUTH_PERIOD_NS
from testbed.reporting.console import bars
from testbed.scenarios.scenario import chosen_overrides, load_settings
from tests.support.guided_rig import GuidedRig, quiet, start
from tests.support.paths import CONFIGS
from tests.vision_pc.hand_eye.still_rig import still_settings
from vision_pc.config.choices import PositioningMethod

RECIPES = ("standard", "paper", "hand_eye", "crane", "servoing")
SEEDS = (1, 2, 3)
PINNED = Path(__file__).parent / "lockstep_trajectories.json"
_EVERY_NS = 2_000_000_000


class Ran(NamedTuple):
    """The digest of a run's event log, and the tool in W every 2 s and at the end (n, 3), m, truly."""

    digest: str
    tool_m: list[list[float]]


def ran(recipe: str, seed: int) -> Ran:
    """The outcome of one recipe with one seed."""
    makers = {"hand_eye": _guided, "crane": _crane, "servoing": _servoing}
    rig = makers.get(recipe, demonstration)(recipe, seed)
    truths = [*rig.world.truths[:: _EVERY_NS // TRUTH_PERIOD_NS], rig.world.plant.truth()]
    return Ran(rig.world.log.digest(), [truth.X_WT[:3, 3].tolist() for truth in truths])


def demonstration(scenario: str, seed: int) -> LockstepRig:
    """The rig after a demonstration in the paper's form, with pictures, of one look."""
    settings = load_settings(CONFIGS, chosen_overrides(CONFIGS, scenario, seed, []))
    rig = LockstepRig(settings, seed, RunLog())
    with bars(quiet=True) as shown:
        demonstrate(Recorder(rig, shown), 1, method=PositioningMethod.PAPER)
    return rig


def corrected(arm: str, seed: int) -> LockstepRig:
    """The rig after one look and its corrected motions, in a drawn laboratory."""
    task = {"seed": seed, "arm": arm, "world": "lab", "eyes": "model", "assignments": []}
    rig = prepared(CONFIGS, task)
    operate(rig, "look-then-move", {"method": "corrected", "aim_mm": 0.0})
    return rig


def _crane(_recipe: str, seed: int) -> LockstepRig:
    return corrected("plant_long_crane", seed)


def _servoing(_recipe: str, seed: int) -> LockstepRig:
    task = {"seed": seed, "arm": "plant", "world": "lab", "eyes": "model", "assignments": []}
    rig = prepared(CONFIGS, task)
    operate(rig, "looking-and-moving", {})
    return rig


def _guided(_recipe: str, seed: int) -> GuidedRig:
    with tempfile.TemporaryDirectory() as directory:
        rig = GuidedRig(still_settings(seed), seed, Path(directory))
        start(rig, "digest", seed)
        for _ in range(2):
            rig.run(rig.guided.next_pose(quiet, False))
            rig.run(rig.guided.sample(quiet))
    return rig


def main(what: str) -> None:
    """``digests``: print those of this checkout, to compare two checkouts on one machine; ``pin``: write the
    trajectories anew, for a change that is meant to change them.
    """
    runs = {f"{recipe} {seed}": ran(recipe, seed) for recipe in RECIPES for seed in SEEDS}
    if what == "digests":
        for name, one in runs.items():
            print(one.digest, name)
        return
    tracks = {name: np.round(one.tool_m, 5).tolist() for name, one in runs.items()}
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(track)}" for name, track in tracks.items())
    PINNED.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
