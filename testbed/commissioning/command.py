"""`longreach commission`: try the joints out, find the valves, write commissioned.yaml."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import yaml

from nominal_arm.description import JOINT_NAMES
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.fault_execution import obey
from plant_emulator.core.faults.schedule import FaultOrder
from protocol.errors import ConfigurationError, LinkLost, LongreachError, MeasurementFailed
from testbed.commissioning.findings import JointFindings, commissioned_from, joint_findings
from testbed.commissioning.live_run import LiveController, excite_live, take_finished
from testbed.commissioning.lockstep_run import Excited, excite_in_lockstep, with_excitation
from testbed.commissioning.presentation import findings_figures, findings_tables, joint_figure
from testbed.commissioning.session import CommissioningSession, trials_told
from testbed.commissioning.trouble_words import trouble_words
from testbed.lockstep.eyes import eyes_with
from testbed.lockstep.run_log import RunLog
from testbed.lockstep.simulated_measurements import load_eye_model, simulated_sight
from testbed.lockstep.world import World
from testbed.reporting.console import bars, err, out, write_json
from testbed.reporting.ctrl_c import kept_on_ctrl_c
from testbed.reporting.plots import png
from testbed.scenarios.settings import Overrides, Settings, load_settings

LONGEST_MIN = 15.0  # of arm time, that commissioning shall stay below


class CommissionRequest(NamedTuple):
    """Which machine, which joints (names), and the session's directory; ``json``: figures as well.

    ``records``: the directory that a running controller records in; it is tried out in place of the emulated
    one; joints that are finished there are taken as they are. ``seen``: what the vision PC's ``valve-trials``
    answered about them. ``faults``: what of the emulated arm is broken from the start.
    """

    config_dir: Path
    overrides: Overrides
    joints: Sequence[str]
    directory: Path
    seed: int
    json: Path | None
    records: Path | None = None
    faults: tuple[FaultOrder, ...] = ()
    seen: Path | None = None


def run_commission(request: CommissionRequest) -> bool:
    """Return True once every joint asked for was found and commissioned.yaml is written.

    Joints that the session has are not tried out again. What broke the excitation off, or made a joint's
    numbers unfit to be used, is told; what was found so far is kept. Raises ConfigurationError for an unknown
    joint or another machine's session.
    """
    if request.faults and request.records is not None:
        raise ConfigurationError(
            "configuration.not_emulated", "--fault breaks the emulated arm; with --records there is none"
        )
    settings = load_settings(request.config_dir, request.overrides)
    joints = [_joint(name) for name in request.joints]
    session = CommissioningSession(request.directory, settings.arm, settings.controller)
    if request.seen is not None:
        session.keep_seen(trials_told(request.seen))
    if request.records is not None:
        take_finished(request.records, settings, session.keep)
    to_do = [joint for joint in joints if joint not in session.finished]
    told = f"{len(joints) - len(to_do)} joints are in {request.directory}, {len(to_do)} are tried out now"
    out.print(told, style="dim", highlight=False)
    complete = _tried_out(settings, request, to_do, session) if to_do else True
    found = _found(session, settings)
    if found:
        out.print(*findings_tables(found, session.seen), sep="\n")
    write_json(request.json, {"joints": findings_figures(found), "complete": complete})
    whole = complete and all(joint in found for joint in joints)
    if whole:
        _write(found, settings, session)
    return whole


def _joint(name: str) -> int:
    if name not in JOINT_NAMES:
        known = ", ".join(JOINT_NAMES)
        raise ConfigurationError("configuration.unknown_joint", f"no joint '{name}'; known: {known}")
    return JOINT_NAMES.index(name)


def _tried_out(
    settings: Settings, request: CommissionRequest, joints: Sequence[int], session: CommissioningSession
) -> bool:
    """Whether all ``joints`` were tried out; what broke it off is told and noted, the arm then stands."""
    try:
        ended = _excited(settings, request, joints, session)
    except (MeasurementFailed, LinkLost) as error:
        return _broken_off(session, error.cause, f"{error.cause}: {error}")
    minutes = ended.seconds / 60.0
    out.print(f"{minutes:.1f} min of arm time, to be below {LONGEST_MIN:g}", highlight=False)
    if ended.trouble is not None:
        return _broken_off(session, ended.trouble.cause, trouble_words(ended.trouble))
    session.ended_by(None)
    return True


def _excited(
    settings: Settings, request: CommissionRequest, joints: Sequence[int], session: CommissioningSession
) -> Excited:
    with (
        kept_on_ctrl_c(lambda: f"{len(session.finished)} joints are kept in {session.directory}"),
        bars() as shown,
        shown.step("trying out the valves") as bar,
    ):
        if request.records is not None:
            link = settings.controller.reference_link
            controller = LiveController(link.host, link.port, request.records)
            return excite_live(controller, settings, session.keep, bar.update)
        world = World(with_excitation(settings, joints), request.seed, RunLog())
        for order in request.faults:
            obey(order, world.plant, Scene(settings.scene).cover)
        eyes = eyes_with(world, simulated_sight(world, load_eye_model(request.config_dir), request.seed))
        return excite_in_lockstep(world, session.keep, bar.update, eyes)


def _broken_off(session: CommissioningSession, cause: str, told: str) -> bool:
    session.ended_by(cause)
    kept = f"{told}; the arm stands, what was found is kept"
    err.print(kept, style="bold red", highlight=False, soft_wrap=True, markup=False)
    return False


def _found(session: CommissioningSession, settings: Settings) -> dict[int, JointFindings]:
    """What the session's recordings say; a joint whose numbers are refused is told, and left out."""
    compensated = settings.controller.valves.pressure_compensated
    found = {}
    for joint, recording in session.recordings().items():
        try:
            found[joint] = joint_findings(recording, compensated)
        except LongreachError as error:
            err.print(f"{error.cause}: {error}", style="bold red", highlight=False)
            continue
        picture = png(joint_figure(recording, found[joint], compensated))
        (session.directory / f"{JOINT_NAMES[joint]}.png").write_bytes(picture)
    return found


def _write(found: Mapping[int, JointFindings], settings: Settings, session: CommissioningSession) -> None:
    made = datetime.now(UTC).isoformat(timespec="seconds"), f"longreach commission {version('longreach')}"
    sources = {joint: session.source(joint) for joint in found}
    content = commissioned_from(found, settings.arm, settings.controller, sources, made, session.seen)
    path = session.directory / "commissioned.yaml"
    path.write_text(yaml.safe_dump(content.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
    told = f"written: {path}; the controller takes it as controller.commissioned={path.resolve()}"
    out.print(told, highlight=False, soft_wrap=True)
