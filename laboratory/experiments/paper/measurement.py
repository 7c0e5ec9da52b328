"""One measurement of the paper's, in lockstep: orientation adjustment, then one of both range adjustments.

A task is flat: ``key``, ``kind`` (``line`` or ``match``), ``seed``, ``eyes``.
Each measurement begins anew, at the start pose of a world drawn from the seed, as the paper's did.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from laboratory.campaigns.rows import Row
from laboratory.experiments.paper.sight import OpencvSensor, RememberingEyes, TracedArm, traced_arrays
from protocol.errors import LongreachError
from protocol.faults import CommandCode
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.simulated_measurements import (
    PixelFrames,
    Sight,
    camera_eyes,
    eyes_with,
    load_eye_model,
    simulated_sight,
)
from testbed.lockstep.world import World
from testbed.scenarios.scenario import load_scenario, load_settings
from vision_pc.application.link_arm import LinkArm
from vision_pc.core.calibration.line_equation import line_equation
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.orientation import adjust_orientation, orientation_error
from vision_pc.core.calibration.trajectory_matching import trajectory_matching
from vision_pc.core.ports import Arm, Eyes
from vision_pc.core.positioning.look_then_move import step
from vision_pc.core.se3 import Array, transform
from vision_pc.core.types import Look

SCENARIO = "paper"


class Bench(NamedTuple):
    """A world with the two ports that programs are written over."""

    world: World
    arm: Arm
    eyes: RememberingEyes


def bench(config_dir: Path, task: Row, *, traces: bool = False) -> Bench:
    """The world that ``task`` asks for, its arm enabled. Raises ConfigurationError.

    ``traces``: every motion is watched, and the arm a TracedArm.
    """
    settings = load_settings(config_dir, load_scenario(config_dir, SCENARIO).world(task["seed"]))
    world = World(settings, task["seed"], RunLog())
    seen: Eyes = camera_eyes(world)
    if task["eyes"] == "opencv":
        seen = eyes_with(world, Sight(PixelFrames(world), OpencvSensor(settings.vision)))
    elif task["eyes"] == "model":
        seen = eyes_with(world, simulated_sight(world, load_eye_model(config_dir), task["seed"]))
    eyes, motion = RememberingEyes(seen, traces=traces), settings.vision.motion
    arm = TracedArm(world.link, motion, eyes) if traces else LinkArm(world.link, motion)
    world.connect()
    run(world.link.command(CommandCode.ENABLE))
    run(world.link.next_state())
    return Bench(world, arm, eyes)


def measure(config_dir: Path, task: Row) -> Row:
    """The row of one measurement; one that ends early tells why, and keeps what it had until then."""
    return measured_on(bench(config_dir, task), task["kind"])[0]


def trace(config_dir: Path, task: Row) -> Mapping[str, Array]:
    """What the camera saw of every motion of the same measurement, as ``traced_arrays``."""
    rig = bench(config_dir, task, traces=True)
    _, match = measured_on(rig, task["kind"])
    assert isinstance(rig.arm, TracedArm)
    return traced_arrays(rig.arm, rig.eyes, match)


def measured_on(rig: Bench, kind: str) -> tuple[Row, LocalCalibration | None]:
    """The row of a measurement, and what its match found."""
    row: Row = {}
    match = None
    try:
        run(adjust_orientation(rig.arm, rig.eyes, _silent, rig.world.settings.vision.programs.orientation))
        _note("start", rig.eyes.looks[0], row)
        _note("oriented", rig.eyes.looks[-1], row)
        if kind == "match":
            match = _match(rig, row)
        else:
            _line(rig, row)
    except LongreachError as error:
        row["failure"] = f"{error.cause}: {error}"
    return row | {"unseen": rig.eyes.unseen, "simulated_s": 1e-9 * rig.world.time_ns}, match


def _line(rig: Bench, row: Row) -> None:
    """3.2.1: circle, one input, and the second input of its "servo-type variant" (5.2.1)."""
    found = run(line_equation(rig.arm, rig.eyes, _silent, rig.world.settings.vision.programs.line_equation))
    look = _at_rest(rig, "input1", row)
    # (16) with "the currently measured variables": from where the tool is, along p_u, by the distance now
    left = float(np.hypot(*(look.X_CO[:2, 3] - look.X_CM[:2, 3])))
    run(rig.arm.move_to(transform(look.X_BT[:3, :3], look.X_BT[:3, 3] + left * found.p_u)))
    _at_rest(rig, "input2", row)


def _match(rig: Bench, row: Row) -> LocalCalibration:
    """3.2.2: path, match, and two inputs by (22)."""
    programs = rig.world.settings.vision.programs
    made = programs.trajectory, programs.local_map
    found = run(trajectory_matching(rig.arm, rig.eyes, _silent, *made))
    for axis, mean, most in zip("xyz", found.residuals.mean_m, found.residuals.maximum_m, strict=True):
        row |= {f"residual_{axis}_mm": 1e3 * float(mean), f"residual_max_{axis}_mm": 1e3 * float(most)}
    look = _at_rest(rig, "matched", row)
    for number in (1, 2):
        run(rig.arm.move_to(step(look, programs.positioning, found).X_BT_ref))
        look = _at_rest(rig, f"input{number}", row)
    return found


def _at_rest(rig: Bench, stage: str, row: Row) -> Look:
    """A look, noted in ``row``."""
    look = run(rig.eyes.look())
    _note(stage, look, row)
    return look


def _note(stage: str, look: Look, row: Row) -> None:
    """Write the errors of ``look`` into ``row``.

    ``STAGE_x_mm`` … are those of Tables 2 and 4: what the picture shows between tool marker and object, the
    depth with the clearance in it.
    """
    e_mm = 1e3 * (look.X_CO[:3, 3] - look.X_CM[:3, 3])
    turn_deg = np.degrees(orientation_error(look))
    for axis, e, turn in zip("xyz", e_mm, turn_deg, strict=True):
        row[f"{stage}_{axis}_mm"] = float(e)
        row[f"{stage}_r{axis}_deg"] = float(turn)


def _silent(fraction: float, note: str) -> None:
    """A campaign has its own progress."""
