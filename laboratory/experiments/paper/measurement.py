"""One measurement of the paper's, in lockstep: orientation adjustment, then one of both range adjustments.

A task is flat: ``key``, ``kind`` (``line`` or ``match``), ``scenario``, ``seed``, ``eyes``, ``assignments``.
Each measurement begins anew, at the start pose of a world drawn from the seed, as the paper's did.
"""

import math
from collections.abc import Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from foundation.configuration import merged, parse_overrides
from laboratory.campaigns.rows import Row
from laboratory.experiments.paper.sight import Traced, Tracer, opencv_sight
from plant_emulator.core.truth import PlantTruth, tool_error
from protocol.errors import LongreachError, MeasurementFailed
from protocol.faults import CommandCode
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.simulated_measurements import camera_eyes, eyes_with, load_eye_model, simulated_sight
from testbed.lockstep.world import VISION_CLOCK_NS, World
from testbed.scenarios.scenario import Settings, load_scenario, load_settings
from vision_pc.application.link_arm import LinkArm
from vision_pc.core.calibration.line_equation import line_equation
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.orientation import adjust_orientation, orientation_error
from vision_pc.core.calibration.trajectory_matching import trajectory_matching
from vision_pc.core.ports import Arm, Eyes, Watch
from vision_pc.core.positioning.look_then_move import step
from vision_pc.core.se3 import Array, angle_between, transform
from vision_pc.core.types import Look

_AROUND_NS = 250_000_000  # truth is averaged over so much on either side of a look
_LOOKS = 5
_UNSEEN = ("measurement.tool_not_seen", "measurement.object_not_seen")


class RememberingEyes:
    """Implements ``Eyes``; ``looks`` are those that were taken, by whatever program.

    A look that shows no tool or no object is taken again, up to ``_LOOKS`` times, and counted in
    ``unseen``: the paper's inputs were given by hand (5.2.2), and nobody gives one on a failed sample.
    """

    def __init__(self, eyes: Eyes) -> None:
        self._eyes = eyes
        self.looks: list[Look] = []
        self.unseen = 0

    async def look(self, frames: int | None = None) -> Look:
        """A look of the eyes. Raises MeasurementFailed when none of them shows tool and object."""
        for _ in range(_LOOKS - 1):
            try:
                return self._remember(await self._eyes.look(frames))
            except MeasurementFailed as failed:
                if failed.cause not in _UNSEEN:
                    raise
                self.unseen += 1
        return self._remember(await self._eyes.look(frames))

    def _remember(self, look: Look) -> Look:
        self.looks.append(look)
        return look

    def watch(self, *, markers: bool, odometry: bool) -> AbstractAsyncContextManager[Watch]:
        """A watch of the eyes."""
        return self._eyes.watch(markers=markers, odometry=odometry)


class Bench(NamedTuple):
    """A world with the two ports that programs are written over."""

    settings: Settings
    world: World
    arm: Arm
    eyes: RememberingEyes


def bench(config_dir: Path, task: Row, tracer: Tracer | None = None) -> Bench:
    """The world that ``task`` asks for, its arm enabled. Raises ConfigurationError."""
    drawn = load_scenario(config_dir, task["scenario"]).world(task["seed"])
    settings = load_settings(config_dir, merged(drawn, parse_overrides(task["assignments"])))
    world = World(settings, task["seed"], RunLog())
    link = world.link
    eyes: Eyes = camera_eyes(world)
    if task["eyes"] == "opencv":
        eyes = eyes_with(world, opencv_sight(world))
    elif task["eyes"] == "model":
        eyes = eyes_with(world, simulated_sight(world, load_eye_model(config_dir), task["seed"]))
    arm: Arm = LinkArm(link, settings.vision.motion)
    world.connect()
    run(link.command(CommandCode.ENABLE))
    run(link.next_state())
    if tracer is not None:
        arm, eyes = tracer.over(arm, eyes)
    return Bench(settings, world, arm, RememberingEyes(eyes))


def measure(config_dir: Path, task: Row) -> Row:
    """The row of one measurement; one that ends early tells why, and keeps what it had until then."""
    row: Row = {"seed": task["seed"]}
    rig = bench(config_dir, task)
    with _kept_to_its_end(row):
        measured_on(rig, task["kind"], row)
    return row


def trace(config_dir: Path, task: Row) -> Row:
    """The same measurement with the camera watching every motion; ``trace.npz`` holds what it saw."""
    tracer = Tracer()
    row: Row = {"seed": task["seed"]}
    rig = bench(config_dir, task, tracer)
    with _kept_to_its_end(row):
        tracer.result = measured_on(rig, task["kind"], row)
    return row | {"trace.npz": tracer.as_npz(rig.world)}


@contextmanager
def _kept_to_its_end(row: Row) -> Iterator[None]:
    try:
        yield
    except LongreachError as error:
        row["failure"] = f"{error.cause}: {error}"


def measured_on(rig: Bench, kind: str, row: Row) -> Traced:
    """What the range adjustment found; ``row`` is filled on the way. Raises what stopped the measurement."""
    programs = rig.settings.vision.programs
    row["payload_kg"] = rig.settings.plant.payload.mass_kg
    row["mount_deg"] = float(np.linalg.norm(rig.settings.scene.mount.rotation_deg))
    try:
        turned = run(adjust_orientation(rig.arm, rig.eyes, _silent, programs.orientation))
        row["tool_shift_mm"] = 1e3 * turned.tool_shift_m[-1]
        _note(rig, "start", rig.eyes.looks[0], row)
        _note(rig, "oriented", rig.eyes.looks[-1], row)
        return {"line": _line, "match": _match}[kind](rig, row)
    finally:
        row["unseen"] = rig.eyes.unseen
        row["simulated_s"] = 1e-9 * rig.world.time_ns


def _line(rig: Bench, row: Row) -> Traced:
    """3.2.1: circle, one input, and the second input of its "servo-type variant" (5.2.1)."""
    found = run(line_equation(rig.arm, rig.eyes, _silent, rig.settings.vision.programs.line_equation))
    row |= {"pictures": found.samples, "seen": found.seen, "d_min_mm": 1e3 * found.distance_m}
    look = _at_rest(rig, "input1", row)
    # (16) with "the currently measured variables": from where the tool is, along p_u, by the distance now
    left = float(np.hypot(*(look.X_CO[:2, 3] - look.X_CM[:2, 3])))
    run(rig.arm.move_to(transform(look.X_BT[:3, :3], look.X_BT[:3, 3] + left * found.p_u)))
    _at_rest(rig, "input2", row)
    return Traced(line=found)


def _match(rig: Bench, row: Row) -> Traced:
    """3.2.2: path, match, and two inputs by (22)."""
    programs = rig.settings.vision.programs
    made = programs.trajectory, programs.local_map
    found = run(trajectory_matching(rig.arm, rig.eyes, _silent, *made))
    for axis, mean, most in zip("xyz", found.residuals.mean_m, found.residuals.maximum_m, strict=True):
        row |= {f"residual_{axis}_mm": 1e3 * float(mean), f"residual_max_{axis}_mm": 1e3 * float(most)}
    row["residual_mm"] = 1e3 * float(np.linalg.norm(found.residuals.mean_m))
    row["rotation_std_deg"] = math.degrees(found.rotation_std())
    row["rotation_error_deg"] = math.degrees(_rotation_error(rig, found))
    row |= {"pictures": found.samples, "inliers": found.inlier_share}
    look = _at_rest(rig, "matched", row)
    for number in (1, 2):
        run(rig.arm.move_to(step(look, programs.positioning, found).X_BT_ref))
        look = _at_rest(rig, f"input{number}", row)
    return Traced(match=found)


def _rotation_error(rig: Bench, found: LocalCalibration) -> float:
    """Angle (rad) between the R_BC found and the camera's true one; the base's own lean is a part of it."""
    X_BT = run(rig.arm.view()).X_BT
    return angle_between(found.rotation_at(X_BT), rig.world.truths[-1].X_WC[:3, :3])


def _at_rest(rig: Bench, stage: str, row: Row) -> Look:
    """A look, noted in ``row``."""
    look = run(rig.eyes.look())
    _note(rig, stage, look, row)
    return look


def _note(rig: Bench, stage: str, look: Look, row: Row) -> None:
    """Write the errors of ``look`` into ``row``, and the true ones beside them.

    ``STAGE_x_mm`` … are those of Tables 2 and 4: what the picture shows between tool marker and object, the
    depth with the clearance in it.
    """
    e_mm = 1e3 * (look.X_CO[:3, 3] - look.X_CM[:3, 3])
    turn_deg = np.degrees(orientation_error(look))
    true_mm = 1e3 * _true_error(rig.world, look.time_ns - VISION_CLOCK_NS)
    for axis, e, turn, true in zip("xyz", e_mm, turn_deg, true_mm, strict=True):
        row[f"{stage}_{axis}_mm"] = float(e)
        row[f"{stage}_r{axis}_deg"] = float(turn)
        row[f"{stage}_true_{axis}_mm"] = float(true)


def _true_error(world: World, time_ns: int) -> Array:
    """The true distance (3,) from tool marker to object in camera axes, about ``time_ns``."""
    around: list[PlantTruth] = [t for t in world.truths if abs(t.time_ns - time_ns) <= _AROUND_NS]
    if not around:
        raise MeasurementFailed("measurement.no_truth", f"no truth recorded about {time_ns} ns")
    return np.asarray(np.mean([tool_error(truth, 0.0) for truth in around], axis=0), dtype=np.float64)


def _silent(fraction: float, note: str) -> None:
    """A campaign has its own progress."""
