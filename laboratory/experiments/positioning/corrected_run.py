"""One run of corrected positioning: turn parallel, three legs, then one look driven open-loop and corrected.

The world is forked after the calibration, so that the strictly one-shot drive, the corrected one and the
second look begin from the very same arm, oil and noise.
"""

import copy
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from foundation.configuration import laid_over, merged, parse_overrides
from laboratory.experiments.positioning.axes import JSON
from laboratory.experiments.positioning.own_commissioning import own_commissioning
from laboratory.experiments.positioning.scenarios import Drawn, draw
from laboratory.experiments.positioning.worlds import WORLDS, WorldName, stated_commissioning
from plant_emulator.core.truth import tool_error
from protocol.errors import LongreachError
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.simulated_measurements import SightMaker, load_eye_model, simulated_sight
from testbed.reporting.console import bars
from testbed.scenarios.scenario import Settings, load_settings
from vision_pc.core.positioning.corrected_positioning import CorrectedResult
from vision_pc.core.positioning.expected_end import ExpectedEnd, ellipse_level, expected_end
from vision_pc.core.positioning.look_then_move import LookVerdict
from vision_pc.core.se3 import Array

AVERAGED = 25  # truths at 50 Hz: half a second at rest


def prediction_of(end: ExpectedEnd, true_mm: Array) -> JSON:
    """What ``end`` predicted of the error in x and y, when it became ``true_mm`` (3,).

    ``probability`` to end inside the tolerance. ``distance2``: squared distance of the true error from the
    predicted mean, by the whole covariance, 2 in the mean when honest; ``level2``: what 95 % stay below.
    """
    off = 1e-3 * true_mm[:2] - end.mean_m[:2]
    distance2 = float(off @ np.linalg.solve(end.covariance[:2, :2], off))
    return {"probability": end.inside, "distance2": distance2, "level2": ellipse_level(end.freedom)}


def named(prefix: str, columns: JSON) -> JSON:
    """``columns`` under longer names."""
    return {f"{prefix}_{name}": value for name, value in columns.items()}


def one_run(config_dir: Path, task: JSON) -> JSON:
    """The row of one seeded run; ``task`` has seed, arm, world, eyes, assignments, and may ask for vision
    that is ``adapting`` and a controller that is ``commissioned``.

    The columns of each branch (``one_shot``, ``look1``, ``look2``) are those of ``driven``; a program that
    refuses or fails ends its branch.
    """
    row = drawn_by(config_dir, task).shown
    try:
        rig = prepared(config_dir, task)
    except LongreachError as error:
        return row | {"failure": f"{error.cause}: {error}"}
    one_shot = driven(copy.deepcopy(rig), {"corrections": 0})
    look1 = driven(rig, {})
    look2 = {} if look1["failure"] else driven(rig, {})
    row |= named("one_shot", one_shot) | named("look1", look1) | named("look2", look2)
    return row | {"simulated_s": 1e-9 * rig.world.time_ns}


def drawn_by(config_dir: Path, task: JSON, unturned: Array | None = None) -> Drawn:
    """The scenario of a task, which has seed, arm and world; ``unturned`` as of ``draw``."""
    return draw(config_dir, task["seed"], task["arm"], WORLDS[WorldName(task["world"])], unturned)


def prepared(config_dir: Path, task: JSON, sight: SightMaker | None = None) -> LockstepRig:
    """The rig of a scenario, turned parallel to the object, its local track recorded.

    ``sight`` overrules what ``task`` says of the eyes.
    """
    settings = settings_of(config_dir, task)
    if sight is None and task["eyes"] == "model":
        model = load_eye_model(config_dir, WORLDS[WorldName(task["world"])].eyes)
        sight = partial(simulated_sight, model=model, seed=task["seed"])
    rig = LockstepRig(settings, task["seed"], RunLog(), sight)
    rig.command("enable")
    operate(rig, "orientation-adjustment", {})
    operate(rig, "local-track", {})
    return rig


def settings_of(
    config_dir: Path, task: JSON, over: JSON | None = None, unturned: Array | None = None
) -> Settings:
    """What was drawn (``unturned`` as of ``draw``), ``over`` it, vision that adapts and a commissioned
    controller where they are asked for, and what was assigned over it.
    """
    over_it = merged(drawn_by(config_dir, task, unturned).overrides, over or {})
    if task.get("adapting"):
        over_it = merged(over_it, {"vision": adapting(config_dir)})
    over_it = merged(over_it, parse_overrides(task["assignments"]))
    settings = load_settings(config_dir, over_it)
    if not (task.get("commissioned") or task.get("own_file")):
        return settings
    return commissioned(config_dir, over_it, settings, task["seed"], own_file=bool(task.get("own_file")))


def adapting(config_dir: Path) -> JSON:
    """What is laid over vision.yaml for a machine that is not the laboratory's."""
    return laid_over(config_dir, "vision_adapting.yaml")[0]


def commissioned(
    config_dir: Path,
    over_it: JSON,
    settings: Settings,
    seed: int,
    *,
    own_file: bool = False,
) -> Settings:
    """``settings``, which come from ``over_it``, with the valves' plates read and ``stated_commissioning``.

    ``own_file``: the machine commissions itself, and makes a file of its own in place of the stated one.
    """
    compensated = settings.plant.valves.compensator_bar > 0.0
    plates = {"name": settings.plant.valve_set, "pressure_compensated": compensated}
    over_it = merged(over_it, {"controller": {"valves": plates}})
    settings = load_settings(config_dir, over_it)
    found = own_commissioning(config_dir, over_it, seed) if own_file else stated_commissioning(settings, seed)
    return settings._replace(controller=settings.controller.model_copy(update={"commissioned": found}))


def driven(rig: LockstepRig, body: JSON) -> JSON:
    """One look and its motion: the true error, mm, and what was predicted ``before`` moving.

    ``first`` and ``last``: what the looks before and after the motion say of the error, judged by the error
    then. ``failure`` is what ended it early, and all that there is then.
    """
    began_mm = true_error_mm(rig)
    try:
        result: CorrectedResult = operate(
            rig, "look-then-move", {"method": "corrected", "aim_mm": 0.0} | body
        )
    except LongreachError as error:
        return {"failure": f"{error.cause}: {error}"}
    error_mm = true_error_mm(rig)
    looks = result.positioning.looks
    row: JSON = {"worst_mm": float(np.abs(error_mm[:2]).max()), "failure": ""}
    row |= {f"true_{axis}_mm": float(value) for axis, value in zip("xyz", error_mm, strict=True)}
    row |= named("before", prediction_of(result.expected, error_mm))
    row |= named("first", prediction_of(_seen(looks[0]), began_mm))
    return row | named("last", prediction_of(_seen(looks[-1]), error_mm))


def _seen(look: LookVerdict) -> ExpectedEnd:
    return expected_end(look.error_m, look.covariance, look.tolerance_m)


def operate(rig: LockstepRig, kind: str, body: JSON) -> Any:
    """The typed result of one of the programs."""
    with bars(quiet=True) as shown, shown.step(kind) as bar:
        return rig.operate(kind, body, bar)


def true_error_mm(rig: LockstepRig) -> Any:
    """The true error (3,) in camera axes over the last half second, in which nothing moved."""
    clearance_m = rig.world.settings.vision.programs.positioning.clearance_m
    truths = rig.world.truths[-AVERAGED:]
    return 1e3 * np.mean([tool_error(truth, clearance_m) for truth in truths], axis=0)
