"""The demonstration as a run: in lockstep or in real time."""

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import httpx

from controller.core.scan_program import own_parts
from controller_st.parts import text_parts
from foundation.secret_source import read_secret
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.wall.bores import hole_places
from plant_emulator.core.fault_execution import obey
from plant_emulator.core.faults.schedule import FaultOrder
from protocol.errors import LongreachError
from testbed.choices import ControllerKind
from testbed.demonstration.sequence import (
    JSON,
    Recorder,
    Rest,
    TimedTruth,
    aimed_truths,
    demonstrate,
    stages,
    traces,
    visit_holes,
)
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.world import CONTROLLER_CLOCK_NS, VISION_CLOCK_NS
from testbed.realtime.launch import PLANT, VISION, Launch, prepare
from testbed.realtime.rest_rig import RestRig, StateSampler, bearer, error_of
from testbed.realtime.supervisor import Supervisor
from testbed.realtime.up import end_on_sigterm, show_console, show_fault_api, show_live, started, tell
from testbed.recordings.plant_truth import FaultRecord, read_truth
from testbed.reporting.console import Bars, bars, out
from testbed.reporting.outcome import Outcome
from testbed.reporting.plots import TracedView
from testbed.reporting.run_directory import Choice, present, read_events, run_directory
from testbed.reporting.run_record import note_settings
from testbed.scenarios.scenario import Overrides, load_settings

_HEALTHY_S = 60.0
_PARTS = {ControllerKind.PYTHON: own_parts, ControllerKind.STRUCTURED_TEXT: text_parts}


class Driven(NamedTuple):
    """What the sequence left behind. ``failure`` stopped it; ``cycle`` is the controller's timing, newest.

    ``overload``: what was said of the machine if it did not keep up, else empty.
    """

    rests: list[Rest]
    views: list[TracedView]
    cycle: JSON | None
    overload: str
    failure: LongreachError | None


def run_demo(
    config_dir: Path,
    overrides: Overrides,
    choice: Choice,
    any_ports: bool,
    runs: Path,
    json_file: Path | None,
    hold: bool = False,
    foxglove: int | None = None,
) -> bool:
    """Whether the true error ended inside the limit; prints the table and writes the report.

    ``hold``: leave everything running at the end, until Ctrl-C. Raises LongreachError when the services
    cannot be started.
    """
    end_on_sigterm()
    began = time.monotonic()
    with run_directory(runs) as directory:
        launch = prepare(
            config_dir,
            overrides,
            directory,
            any_ports=any_ports,
            foxglove=foxglove,
            controller=choice.controller,
        )
        note_settings(directory, launch.settings)
        with bars() as shown, started(launch, shown) as supervisor:
            show_console(launch)
            show_fault_api(launch)
            show_live(launch)
            driven = drive(launch, choice, shown, supervisor)
            if hold:
                _wait_for_ctrl_c(launch, supervisor)
        return _present(launch, choice, driven, time.monotonic() - began, json_file)


def _wait_for_ctrl_c(launch: Launch, supervisor: Supervisor) -> None:
    """Wait for Ctrl-C, as `longreach up` does; the verdict follows."""
    out.print("all goes on running; Ctrl-C ends it and tells the verdict", highlight=False)
    show_console(launch)
    with contextlib.suppress(KeyboardInterrupt):
        supervisor.watch(tell=tell)


def _present(launch: Launch, choice: Choice, driven: Driven, wall_s: float, json_file: Path | None) -> bool:
    """Whether the demonstration has passed by the plant's own recording; table and report are out."""
    recording = read_truth(launch.records(PLANT) / "truth.mcap")
    # On one machine the plant's monotonic clock is vision's too.
    told = [TimedTruth(record.log_ns, record.truth) for record in recording.truths]
    truths = aimed_truths(told, driven.rests, hole_places(launch.settings.scene.wall))
    clearance_m = launch.settings.vision.programs.positioning.clearance_m
    outcome = Outcome(
        mode="real time",
        scenario=choice.scenario,
        seed=choice.seed,
        looks=choice.looks,
        stages=stages(driven.rests, truths, clearance_m),
        wall_s=wall_s,
        simulated_s=1e-9 * (truths[-1].time_ns - truths[0].time_ns),
        details=_details(launch, driven, recording.faults),
        every=choice.holes,
    )
    curves = traces(truths, driven.views, clearance_m, launch.settings.arm)
    pictures = [rest.picture for rest in driven.rests]
    events = read_events(launch.records(VISION))
    return present(launch.directory, outcome, curves, pictures, events, json_file)


def drive(launch: Launch, choice: Choice, shown: Bars, supervisor: Supervisor) -> Driven:
    """What the sequence left behind, however far it came.

    Raises ServiceFailed when a service has ended by itself: that explains whatever else went wrong.
    """
    rig = RestRig(launch.rest_url, launch.rest_token())
    recorder = Recorder(rig, shown)
    failure: LongreachError | None = None
    with StateSampler(launch.rest_url, launch.rest_token()) as sampler:
        try:
            with shown.step("waiting for links and camera"):
                rig.wait_healthy(_HEALTHY_S)
            _break(launch, choice.faults)
            if choice.holes:
                visit_holes(rig, recorder)
            else:
                demonstrate(rig, recorder, choice.looks, choice.programs, choice.method)
        except LongreachError as error:
            supervisor.check()
            failure = error
        finally:
            rig.close()
    return Driven(recorder.rests, sampler.views, sampler.cycle, sampler.overload, failure)


def _details(launch: Launch, driven: Driven, faults: Sequence[FaultRecord]) -> dict[str, Any]:
    details: dict[str, Any] = {"directory": launch.directory}
    if driven.failure is not None:
        details["failure"] = f"{driven.failure.cause}: {driven.failure}"
    if driven.overload:
        details["overload"] = driven.overload
    if driven.cycle is not None:
        details["controller_cycle"] = driven.cycle
    if faults:
        details["faults"] = [fault._asdict() for fault in faults]
    return details


def _break(launch: Launch, orders: Sequence[FaultOrder]) -> None:
    """Have the plant break what is ordered. Raises what its API answers."""
    face = launch.settings.plant_service.fault_face
    token = read_secret(face.tokens.operate, "operate token")
    for order in orders:
        url = f"http://{face.host}:{face.port}"
        with httpx.Client(base_url=url, headers=bearer(token), trust_env=False) as client:
            answer = client.post("/faults", json=order.model_dump(mode="json"))
        if not answer.is_success:
            raise error_of(answer.json())


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
    rig = LockstepRig(settings, choice.seed, log, parts=_PARTS[choice.controller])
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
            demonstrate(rig, recorder, choice.looks, choice.programs, choice.method)
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
