"""`longreach identify`: a plant file of one's own machine from a recording of its motion."""

from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from foundation.configuration import configuration_hash, parse_overrides
from nominal_arm.description import NominalArm
from plant_emulator.config.plant import PlantConfig
from testbed.cli.options import IdentifyOptions
from testbed.identification.excitation import (
    FINE_STEP_MS,
    candidates,
    chosen,
    held_out,
    information_of,
    informed,
    not_told,
    record,
    standard,
    widest_overlap,
)
from testbed.identification.excitation import PLANNED_JOINTS as PLANNED
from testbed.identification.findings import (
    excess,
    findings,
    first_stages,
    found_table,
    validation_table,
    write_plant_file,
)
from testbed.identification.fit import identify, problem_of
from testbed.identification.parameters import parameters_of
from testbed.identification.recording import (
    Machine,
    check_recording,
    hex_hash,
    read_recording,
    write_recording,
)
from testbed.identification.validation import check_believable, check_noise, leaves_noise, validate
from testbed.reporting.console import Columns, bars, listed, out, writable, write_json
from testbed.scenarios.scenario import load_settings


class ToIdentify(NamedTuple):
    """The configuration that the command was given: the plant to begin with, the machine that it is of."""

    plant: PlantConfig
    arm: NominalArm
    machine: Machine


def run_identify(
    asked: ToIdentify, recording: Path, options: IdentifyOptions, seed: int, json_file: Path | None
) -> bool:
    """Whether what was asked for came out: a recording, or a plant that explains one, and its file."""
    if options.make:
        return make_recording(asked, writable(recording) or recording, seed)
    if options.plan:
        return make_plan(asked, recording, options, json_file)
    motion = read_recording(recording)
    joints = check_recording(motion, asked.machine)
    with bars() as shown, shown.step("fitting the plant") as bar, pool_of(options.workers) as pool:
        found = identify(asked.plant, motion, joints, pool, lambda note: bar.update(0.5, note))
        signals = validate(found, motion)
    fitted = findings(found)
    for made in (*first_stages(found.simple), found_table(fitted), validation_table(signals)):
        out.print(made)
    chi = excess(found)
    out.print(f"χ² of what is left: {chi:.2f} of the noise; {found.whole.runs} runs of the plant")
    figures = {
        "recording": motion.sha256,
        "chi2_per_sample": chi,
        "chi2_still_promised": found.whole.promised,
    }
    write_json(json_file, {**figures, "parameters": fitted, "signals": signals})
    check_believable(found, signals)
    if not options.unsure:
        check_noise(signals)
    write_plant_file(options.plant_file, found, asked.plant, motion, leaves_noise(signals))
    out.print(f"{options.plant_file}: the plant, as the emulator loads it", highlight=False, soft_wrap=True)
    return True


def asked_of(config_dir: Path, settings: list[str]) -> ToIdentify:
    """The plant and the machine that the files of ``config_dir`` describe, ``settings`` laid over them."""
    chosen = load_settings(config_dir, parse_overrides(settings))
    arm_hash = hex_hash(configuration_hash(chosen.arm))
    return ToIdentify(chosen.plant, chosen.arm, Machine(chosen.arm.name, arm_hash, chosen.plant.valve_set))


def make_recording(asked: ToIdentify, path: Path, seed: int) -> bool:
    """Drive the emulated plant through the usual excitation and write what its sensors told."""
    overlap = widest_overlap(asked.plant)
    plant = asked.plant.model_copy(update={"step_ms": min(asked.plant.step_ms, FINE_STEP_MS)})
    made = record(plant, asked.machine, standard(overlap), held_out(overlap), seed)
    written = write_recording(path, made)
    summary = f"{len(written.time_s)} samples, {written.time_s[-1]:.1f} s, sha256 {written.sha256[:12]}"
    out.print(f"{path}: {summary}", highlight=False, soft_wrap=True)
    return True


def make_plan(asked: ToIdentify, path: Path, options: IdentifyOptions, json_file: Path | None) -> bool:
    """Show what the recording at ``path``, if there is one, cannot give, and the pieces that give most."""
    parameters, before = parameters_of(asked.plant, PLANNED), None
    motion = read_recording(path) if path.exists() else None
    pieces = candidates(widest_overlap(asked.plant))
    with bars() as shown, shown.step("weighing pieces") as bar, pool_of(options.workers) as pool:
        if motion is not None:
            check_recording(motion, asked.machine)
            before = information_of(problem_of(asked.plant, motion, PLANNED), len(parameters), pool)
        weighed = []
        for piece in pieces:
            weighed.append(informed(asked.plant, asked.arm, asked.machine, piece, pool))
            bar.update(len(weighed) / len(pieces), piece.name)
    steps = chosen(weighed, options.plan_s, before)
    missing = [] if before is None else not_told(before, parameters)
    if before is not None:
        out.print(f"{path} cannot give: {', '.join(missing) or 'nothing is missing'}", highlight=False)
    for one in weighed:
        if one.refused:
            out.print(f"left out: {one.piece.name}: {one.refused}", style="dim", highlight=False)
    columns: Columns = {
        "piece": lambda s: s.piece.name,
        "bits gained": "{bits:.1f}",
        "identified": "{identified}",
    }
    out.print(
        listed(f"the most informative {options.plan_s:g} s, {len(parameters)} parameters", columns, steps)
    )
    write_json(json_file, {"cannot_give": missing, "plan": steps})
    return bool(steps)


def pool_of(workers: int) -> AbstractContextManager[Executor | None]:
    """Processes that run the plant; None where one is enough."""
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn")) if workers > 1 else nullcontext()
