"""One run of corrected positioning: turn parallel, three legs, then one look driven open-loop and corrected.

The world is forked after the calibration, so that the strictly one-shot drive, the corrected one and the
second look begin from the very same arm, oil and noise.
"""

import copy
import math
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foundation.configuration import laid_over, merged, parse_overrides
from laboratory.campaigns.rows import UNKNOWN, XYZ, xyz
from laboratory.experiments.positioning.own_commissioning import own_commissioning
from laboratory.experiments.positioning.scenarios import Drawn, draw
from laboratory.experiments.positioning.worlds import WORLDS, WorldName, stated_commissioning
from plant_emulator.core.truth import tool_error
from protocol.errors import LongreachError
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.simulated_measurements import EyeCondition, SightMaker, load_eye_model, simulated_sight
from testbed.reporting.console import bars
from testbed.scenarios.scenario import Settings, load_settings
from vision_pc.core.positioning.corrected_positioning import CorrectedResult
from vision_pc.core.positioning.expected_end import ExpectedEnd, ellipse_level, expected_end
from vision_pc.core.positioning.look_then_move import LookVerdict
from vision_pc.core.se3 import Array

_AVERAGED = 25  # truths at 50 Hz: half a second at rest
JSON = dict[str, Any]


class Prediction(NamedTuple):
    """The predicted error at the end in x and y, and where the true error lies in it.

    ``probability`` to end inside the tolerance; mean, standard deviations, correlation and Student's
    ``freedom`` (NaN: normal). ``distance2``: squared distance of the true error from the mean, by the whole
    covariance, 2 in the mean when honest; ``level2``: what 95 % stay below.
    """

    probability: float = float("nan")
    mean_x_mm: float = float("nan")
    mean_y_mm: float = float("nan")
    std_x_mm: float = float("nan")
    std_y_mm: float = float("nan")
    correlation: float = float("nan")
    freedom: float = float("nan")
    distance2: float = float("nan")
    level2: float = float("nan")


def prediction_of(end: ExpectedEnd, true_mm: Array) -> Prediction:
    """The columns of ``end``, when the error became ``true_mm`` (3,)."""
    x, y = 1e3 * end.mean_m[:2]
    std_x, std_y = 1e3 * end.std_m[:2]
    off = 1e-3 * true_mm[:2] - end.mean_m[:2]
    distance2 = float(off @ np.linalg.solve(end.covariance[:2, :2], off))
    freedom = end.freedom if np.isfinite(end.freedom) else float("nan")
    level = ellipse_level(end.freedom)
    return Prediction(
        end.inside, float(x), float(y), float(std_x), float(std_y), end.correlation, freedom, distance2, level
    )


class Branch(NamedTuple):
    """One look and its drive: true error, the servo's part, what was predicted, measured, mm.

    ``before``: predicted before moving; ``after``: by odometry, before the last look. ``first`` and ``last``:
    what the looks before and after the drive say of the error, judged by the error then.
    """

    true_mm: XYZ = UNKNOWN
    servo_mm: XYZ = UNKNOWN
    std_mm: XYZ = UNKNOWN
    measured_mm: XYZ = UNKNOWN
    worst_mm: float = math.nan
    before: Prediction = Prediction()
    after: Prediction = Prediction()
    first: Prediction = Prediction()
    last: Prediction = Prediction()
    steps: int | None = None
    ended: str = ""
    failure: str = ""


class PositioningRow(NamedTuple):
    """One run: what was drawn, and each branch; a program that refuses or fails ends its branch.

    ``commissioned``: the controller knows its valves: as ``stated_commissioning`` tells, or by ``own_file``,
    of a commissioning that was run.
    """

    seed: int
    arm: str
    payload_kg: float
    mount_deg: float
    lever_m: float
    distance_m: float
    disparity_px: float
    world: str = ""
    adapting: bool = False
    commissioned: bool = False
    own_file: bool = False
    unreachable: int | None = None
    unseen: int | None = None
    one_shot: Branch = Branch()
    look1: Branch = Branch()
    look2: Branch = Branch()
    simulated_s: float = math.nan
    failure: str = ""
    cpu_s: float = math.nan


def one_run(config_dir: Path, task: JSON) -> JSON:
    """The row of one seeded run; ``task`` has seed, arm, world, eyes, assignments, and may ask for vision
    that is ``adapting`` and a controller that is ``commissioned``.
    """
    drawn = drawn_by(config_dir, task)
    row: JSON = {"seed": task["seed"], "arm": task["arm"], "world": task["world"], **drawn.shown}
    row |= {name: bool(task.get(name)) for name in ("adapting", "commissioned", "own_file")}
    try:
        rig = prepared(config_dir, task)
    except LongreachError as error:
        return row | {"failure": f"{error.cause}: {error}"}
    one_shot = driven(copy.deepcopy(rig), {"corrections": 0})
    look1 = driven(rig, {})
    look2 = Branch(failure="") if look1.failure else driven(rig, {})
    branches = {"one_shot": one_shot, "look1": look1, "look2": look2}
    return row | branches | {"simulated_s": 1e-9 * rig.world.time_ns}


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
    asked = merged(drawn_by(config_dir, task, unturned).overrides, over or {})
    if task.get("adapting"):
        asked = merged(asked, {"vision": adapting(config_dir)})
    asked = merged(asked, parse_overrides(task["assignments"]))
    settings = load_settings(config_dir, asked)
    if not task.get("commissioned"):
        return settings
    condition = WORLDS[WorldName(task["world"])].eyes if task.get("own_file") else None
    return commissioned(config_dir, asked, settings, task["seed"], condition)


def adapting(config_dir: Path) -> JSON:
    """What is laid over vision.yaml for a machine that is not the laboratory's."""
    return laid_over(config_dir, "vision_adapting.yaml")[0]


def commissioned(
    config_dir: Path,
    asked: JSON,
    settings: Settings,
    seed: int,
    watched: EyeCondition | None = None,
) -> Settings:
    """``settings``, which come from ``asked``, with the valves' plates read and ``stated_commissioning``.

    ``watched``: eyes before which the machine commissions itself, and makes a file of its own in place of
    the stated one.
    """
    compensated = settings.plant.valves.compensator_bar > 0.0
    plates = {"name": settings.plant.valve_set, "pressure_compensated": compensated}
    asked = merged(asked, {"controller": {"valves": plates}})
    settings = load_settings(config_dir, asked)
    if watched is None:
        found = stated_commissioning(settings, seed)
    else:
        found = own_commissioning(config_dir, asked, seed, watched)
    return settings._replace(controller=settings.controller.model_copy(update={"commissioned": found}))


def driven(rig: LockstepRig, body: JSON) -> Branch:
    """One look and its drive; ``failure`` is what ended it early."""
    began_mm = true_error_mm(rig)
    try:
        result: CorrectedResult = operate(
            rig, "look-then-move", {"method": "corrected", "aim_mm": 0.0} | body
        )
    except LongreachError as error:
        return Branch(failure=f"{error.cause}: {error}")
    error_mm = true_error_mm(rig)
    steps, looks = result.positioning.steps, result.positioning.looks
    reference_m = steps[-1].X_BT_ref[:3, 3] if steps else np.full(3, math.nan)
    off_mm = 1e3 * (np.array(rig.link.state.X_BT.p_m) - reference_m)
    X_BC = np.linalg.inv(rig.world.plant.truth().X_WB) @ rig.world.plant.truth().X_WC
    return Branch(
        true_mm=xyz(error_mm),
        servo_mm=xyz(X_BC[:3, :3].T @ off_mm),
        std_mm=xyz([1e3 * float(value) for value in result.expected.std_m]),
        measured_mm=xyz([1e3 * float(value) for value in result.measured_residual_m]),
        worst_mm=float(np.abs(error_mm[:2]).max()),
        before=prediction_of(result.expected, error_mm),
        after=prediction_of(result.seen, error_mm),
        first=prediction_of(_seen(looks[0]), began_mm),
        last=prediction_of(_seen(looks[-1]), error_mm),
        steps=len(steps),
        ended=result.positioning.ended,
    )


def _seen(look: LookVerdict) -> ExpectedEnd:
    return expected_end(look.error_m, look.covariance, look.tolerance_m)


def operate(rig: LockstepRig, kind: str, body: JSON) -> Any:
    """The typed result of one of the programs."""
    with bars(quiet=True) as shown, shown.step(kind) as bar:
        return rig.operate(kind, body, bar)


def true_error_mm(rig: LockstepRig) -> Any:
    """The true error (3,) in camera axes over the last half second, in which nothing moved."""
    clearance_m = rig.world.settings.vision.programs.positioning.clearance_m
    truths = rig.world.truths[-_AVERAGED:]
    return 1e3 * np.mean([tool_error(truth, clearance_m) for truth in truths], axis=0)
