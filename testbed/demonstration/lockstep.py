"""`longreach demo --lockstep`: the same sequence in simulated time, bit-identical for a seed."""

import time
from pathlib import Path
from typing import NamedTuple

from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.wall.bores import hole_places
from plant_emulator.core.fault_execution import obey
from protocol.errors import LongreachError
from testbed.demonstration.holes import aimed_truths, visit_holes
from testbed.demonstration.sequence import Recorder, Rest, TimedTruth, demonstrate, stages, traces
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.run_log import RunLog
from testbed.lockstep.world import CONTROLLER_CLOCK_NS, VISION_CLOCK_NS
from testbed.reporting.console import Bars, bars
from testbed.reporting.outcome import Outcome
from testbed.reporting.plots import TracedView
from testbed.reporting.presentation import Choice, present
from testbed.reporting.run_directory import run_directory
from testbed.reporting.run_record import note_settings
from testbed.scenarios.settings import Overrides, load_settings


class LockstepRun(NamedTuple):
    """One run: its outcome, and what a report is made of."""

    outcome: Outcome
    rests: list[Rest]
    truths: list[TimedTruth]
    views: list[TracedView]
    log: RunLog


def run_lockstep(
    config_dir: Path, overrides: Overrides, choice: Choice, shown: Bars, record: Path | None = None
) -> LockstepRun:
    """A whole demonstration in lockstep; a step that fails ends it and is told in the outcome's details.

    ``record``: the directory in which all parts are recorded, from when the link is open. Raises
    ConfigurationError.
    """
    began = time.perf_counter()
    settings = load_settings(config_dir, overrides)
    log = RunLog()
    log.add(0, "run", scenario=choice.scenario, seed=choice.seed, overrides=overrides)
    rig = LockstepRig(settings, choice.seed, log)
    recordings = None
    if record is not None:
        recordings = rig.record_in(record, f"lockstep {choice.scenario} seed {choice.seed}")
    recorder = Recorder(rig, shown)
    details = {}
    try:
        for order in choice.faults:
            obey(order, rig.world.plant, Scene(settings.scene).cover)
        if choice.holes:
            visit_holes(rig, recorder)
        else:
            demonstrate(rig, recorder, choice.looks, choice.programs)
    except LongreachError as error:
        details["failure"] = f"{error.cause}: {error}"
        log.add(rig.world.time_ns, "failure", cause=error.cause, message=str(error))
    finally:
        if recordings is not None:
            recordings.close()
    truths, views = _truths(rig, recorder.rests), _views(rig)
    clearance_m = settings.vision.programs.positioning.clearance_m
    outcome = Outcome(
        mode="lockstep",
        scenario=choice.scenario,
        seed=choice.seed,
        looks=choice.looks,
        stages=stages(recorder.rests, truths, clearance_m),
        wall_s=time.perf_counter() - began,
        simulated_s=1e-9 * rig.world.time_ns,
        details=details | {"event_log_sha256": log.digest()},
        every=choice.holes,
    )
    return LockstepRun(outcome, recorder.rests, truths, views, log)


def _truths(rig: LockstepRig, rests: list[Rest]) -> list[TimedTruth]:
    told = [TimedTruth(truth.time_ns + VISION_CLOCK_NS, truth) for truth in rig.world.truths]
    return aimed_truths(told, rests, hole_places(rig.world.settings.scene.wall))


def _views(rig: LockstepRig) -> list[TracedView]:
    return [
        TracedView(s.time_ns - CONTROLLER_CLOCK_NS + VISION_CLOCK_NS, s.X_BT.p_m, s.q_cmd, s.q_meas)
        for s in rig.world.states
    ]


def run_lockstep_demo(
    config_dir: Path, overrides: Overrides, choice: Choice, runs: Path, json_file: Path | None
) -> bool:
    """Whether the true error ended inside the limit; prints the table and writes the report."""
    settings = load_settings(config_dir, overrides)
    clearance_m = settings.vision.programs.positioning.clearance_m
    with run_directory(runs) as directory:
        note_settings(directory, settings)
        with bars() as shown:
            done = run_lockstep(config_dir, overrides, choice, shown, directory)
        curves = traces(done.truths, done.views, clearance_m, settings.arm)
        pictures = [rest.picture for rest in done.rests]
        return present(directory, done.outcome, curves, pictures, done.log.events, json_file)
