"""The demonstration as a run: in lockstep or in real time."""

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path

from controller.core.scan_program import own_parts
from controller_st.parts import text_parts
from foundation.secret_source import read_secret
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.fault_execution import obey
from plant_emulator.core.faults.schedule import FaultOrder
from protocol.errors import LongreachError
from testbed.choices import ClockKind, ControllerKind
from testbed.demonstration.sequence import (
    Recorder,
    Rest,
    TimedTruths,
    demonstrate,
    error_trace,
    stages,
)
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.world import VISION_CLOCK_NS
from testbed.realtime.launch import PLANT, VISION, Launch, prepare
from testbed.realtime.rest_rig import RestRig, answered, error_of, rest_client
from testbed.realtime.supervisor import Supervisor
from testbed.realtime.up import end_on_sigterm, show_addresses, started
from testbed.recordings.plant_truth import read_truth
from testbed.reporting.console import Bars, bars
from testbed.reporting.outcome import Outcome
from testbed.reporting.plots import ErrorTrace
from testbed.reporting.report import Picture
from testbed.reporting.run_directory import Choice, present, read_events, run_directory
from testbed.scenarios.scenario import Overrides, Settings, load_settings
from vision_pc.application.results import JSON

_HEALTHY_S = 60.0
_PARTS = {ControllerKind.PYTHON: own_parts, ControllerKind.STRUCTURED_TEXT: text_parts}


def run_demo(
    config_dir: Path,
    overrides: Overrides,
    choice: Choice,
    any_ports: bool,
    runs: Path,
    json_file: Path | None,
    foxglove: int | None = None,
) -> bool:
    """Whether the true error ended inside the limit; prints the table and writes the report.

    By the plant's clock time passes while something is asked of the machine: two runs are the same. Raises
    LongreachError when the services cannot be started.
    """
    end_on_sigterm()
    began_s = time.monotonic()
    with run_directory(runs) as directory:
        launch = prepare(
            config_dir,
            overrides,
            directory,
            any_ports=any_ports,
            foxglove=foxglove,
            controller=choice.controller,
            timing=choice.timing._replace(goes="on_request"),
        )
        with bars() as shown, started(launch, shown) as supervisor:
            show_addresses(launch)
            with contextlib.closing(RestRig(launch.rest_url, launch.rest_token())) as rig:
                recorder = Recorder(rig, shown)
                details = drive(launch, choice, rig, recorder, supervisor)
        recording = read_truth(launch.records(PLANT) / "truth.mcap")
        # The plant's clock is vision's too: one of the machine, or the plant's own.
        truths = [(record.log_ns, record.truth) for record in recording.truths]
        details |= {"directory": directory, "faults": [fault._asdict() for fault in recording.faults]}
        mode = "three processes, by the plant's clock" if launch.clock is ClockKind.PLANT else "real time"
        wall_s = time.monotonic() - began_s
        outcome, trace = judged(mode, choice, launch.settings, recorder.rests, truths, wall_s, details)
        pictures = [rest.picture for rest in recorder.rests]
        return present(directory, outcome, trace, pictures, read_events(launch.records(VISION)), json_file)


def drive(launch: Launch, choice: Choice, rig: RestRig, recorder: Recorder, supervisor: Supervisor) -> JSON:
    """Run the sequence; what stopped it, and the controller's newest timing, as a report's details.

    Raises ServiceFailed when a service has ended by itself: that explains whatever else went wrong.
    """
    try:
        with recorder.bars.step("waiting for links and camera"):
            rig.wait_healthy(_HEALTHY_S)
        _break(launch, choice.faults)
        demonstrate(recorder, choice.looks, choice.programs, choice.method)
        return {"controller_cycle": rig.state()["cycle"]}
    except LongreachError as error:
        supervisor.check()
        return {"failure": f"{error.cause}: {error}"}


def _break(launch: Launch, orders: Sequence[FaultOrder]) -> None:
    """Have the plant break what is ordered. Raises what its API answers."""
    face = launch.settings.plant_service.fault_face
    token = read_secret(face.tokens.operate, "operate token")
    url = f"http://{face.host}:{face.port}"
    with rest_client(url, token) as client:
        for order in orders:
            answer = client.post("/faults", json=order.model_dump(mode="json"))
            if not answer.is_success:
                raise error_of(answered(answer))


def judged(
    mode: str,
    choice: Choice,
    settings: Settings,
    rests: Sequence[Rest],
    truths: TimedTruths,
    wall_s: float,
    details: JSON,
) -> tuple[Outcome, ErrorTrace]:
    """What was reached, by the plant's own ``truths``, and the true error over the run."""
    clearance_m = settings.vision.programs.positioning.clearance_m
    ends = stages(rests, truths, clearance_m)
    simulated_s = 1e-9 * (truths[-1][0] - truths[0][0])
    request = choice.scenario, choice.seed, choice.looks
    return Outcome(mode, *request, ends, wall_s, simulated_s, details), error_trace(truths, clearance_m)


def run_lockstep(
    config_dir: Path, overrides: Overrides, choice: Choice, shown: Bars, record: Path | None = None
) -> tuple[Outcome, ErrorTrace, list[Picture], RunLog]:
    """A whole demonstration in lockstep; a step that fails ends it and is told in the outcome's details.

    ``record``: the directory in which all parts are recorded, from when the link is open. Raises
    ConfigurationError.
    """
    began_s = time.perf_counter()
    settings = load_settings(config_dir, overrides)
    log = RunLog()
    log.add(0, "run", scenario=choice.scenario, seed=choice.seed, overrides=overrides)
    rig = LockstepRig(settings, choice.seed, log, parts=_PARTS[choice.controller])
    recorder = Recorder(rig, shown)
    details: JSON = {}
    with contextlib.ExitStack() as stack:
        if record is not None:
            session = f"lockstep {choice.scenario} seed {choice.seed}"
            stack.enter_context(contextlib.closing(rig.record_in(record, session)))
        try:
            for order in choice.faults:
                obey(order, rig.world.plant, Scene(settings.scene).cover)
            demonstrate(recorder, choice.looks, choice.programs, choice.method)
        except LongreachError as error:
            details["failure"] = f"{error.cause}: {error}"
            log.add(rig.world.time_ns, "failure", cause=error.cause, message=str(error))
    truths = [(truth.time_ns + VISION_CLOCK_NS, truth) for truth in rig.world.truths]
    details["event_log_sha256"] = log.digest()
    wall_s = time.perf_counter() - began_s
    outcome, trace = judged("lockstep", choice, settings, recorder.rests, truths, wall_s, details)
    return outcome, trace, [rest.picture for rest in recorder.rests], log


def run_lockstep_demo(
    config_dir: Path, overrides: Overrides, choice: Choice, runs: Path, json_file: Path | None
) -> bool:
    """Whether the true error ended inside the limit; prints the table and writes the report."""
    with run_directory(runs) as directory:
        with bars() as shown:
            outcome, trace, pictures, log = run_lockstep(config_dir, overrides, choice, shown, directory)
        return present(directory, outcome, trace, pictures, log.events, json_file)
