"""Runs in lockstep whose event logs are pinned by their digests: what a change that changes nothing keeps.

Each recipe drives one world for a while: the demonstration with pictures, the corrected positioning on the
crane and visual servoing with the eye model, and a guided hand-eye session with pictures.
"""

import importlib.metadata
import json
import tempfile
from pathlib import Path
from typing import NamedTuple

import llvmlite.binding

from testbed.demonstration.sequence import Recorder, demonstrate
from testbed.experiments.positioning.corrected_run import operate, prepared
from testbed.lockstep import guided_rig
from testbed.lockstep.guided_rig import GuidedRig, quiet
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.run_log import RunLog
from testbed.reporting.console import bars
from testbed.scenarios.settings import chosen_overrides, load_settings
from tests.support.paths import CONFIGS
from tests.vision_pc.hand_eye.still_rig import still_settings

RECIPES = ("standard", "paper", "hand_eye", "crane", "servoing")
SEEDS = (1, 2, 3)
PINNED = Path(__file__).parent / "lockstep_digests.json"


class Ran(NamedTuple):
    """A run's event log, as its digest and length, and where the tool truly ended in W, m."""

    digest: str
    events: int
    tool_m: tuple[float, float, float]


def ran(recipe: str, seed: int) -> Ran:
    """The outcome of one recipe with one seed."""
    makers = {"hand_eye": _guided, "crane": _crane, "servoing": _servoing}
    rig = makers.get(recipe, _demonstration)(recipe, seed)
    x, y, z = rig.world.plant.truth().X_WT[:3, 3].tolist()
    return Ran(rig.world.log.digest(), len(rig.world.log.events), (x, y, z))


def _demonstration(scenario: str, seed: int) -> LockstepRig:
    settings = load_settings(CONFIGS, chosen_overrides(CONFIGS, scenario, seed, []))
    rig = LockstepRig(settings, seed, RunLog())
    with bars(quiet=True) as shown:
        demonstrate(rig, Recorder(rig, shown), 1)
    return rig


def _crane(_recipe: str, seed: int) -> LockstepRig:
    task = {"seed": seed, "arm": "plant_long_crane", "world": "lab", "eyes": "model", "assignments": []}
    rig = prepared(CONFIGS, task)
    operate(rig, "look-then-move", {"method": "corrected", "aim_mm": 0.0})
    return rig


def _servoing(_recipe: str, seed: int) -> LockstepRig:
    task = {"seed": seed, "arm": "plant", "world": "lab", "eyes": "model", "assignments": []}
    rig = prepared(CONFIGS, task)
    operate(rig, "looking-and-moving", {})
    return rig


def _guided(_recipe: str, seed: int) -> GuidedRig:
    with tempfile.TemporaryDirectory() as directory:
        rig = GuidedRig(still_settings(seed), seed, Path(directory))
        guided_rig.start(rig, "digest", seed)
        for _ in range(2):
            rig.run(rig.guided.next_pose(quiet, False))
            rig.run(rig.guided.sample(quiet))
    return rig


def machine() -> dict[str, str]:
    """What the last bit of a run depends on besides this project: the processor and the libraries."""
    libraries = ("numpy", "scipy", "numba", "llvmlite", "opencv-python-headless", "ruckig", "clarabel")
    versions = {name: importlib.metadata.version(name) for name in libraries}
    return {"processor": llvmlite.binding.get_host_cpu_name(), **versions}


if __name__ == "__main__":  # writes the pinned digests anew: a change that is meant to change them
    runs = {f"{recipe} {seed}": ran(recipe, seed)._asdict() for recipe in RECIPES for seed in SEEDS}
    PINNED.write_text(json.dumps({"machine": machine(), "runs": runs}, indent=1) + "\n", encoding="utf-8")
