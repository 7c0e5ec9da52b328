"""`longreach commission`: try the joints out, find the valves, write commissioned.yaml."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from matplotlib.figure import Figure
from rich.table import Table

from controller.core.excitation.plan import StrokeKind, Trouble
from nominal_arm.description import JOINT_NAMES
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.fault_execution import obey
from plant_emulator.core.faults.schedule import FaultOrder
from protocol.errors import ConfigurationError, LinkLost, LongreachError, MeasurementFailed
from testbed.commissioning.findings import JointFindings, commissioned_from, joint_findings
from testbed.commissioning.ramp_rows import Uncertain, smoothed_speed
from testbed.commissioning.recording import (
    CommissioningSession,
    JointRecording,
    ToldNumber,
    TrialsTold,
    strokes_in,
    trials_told,
)
from testbed.commissioning.runs import (
    Excited,
    LiveController,
    excite_in_lockstep,
    excite_live,
    take_finished,
    with_excitation,
)
from testbed.commissioning.valve_fit import EdgeFindings
from testbed.lockstep.clock import RunLog
from testbed.lockstep.simulated_measurements import eyes_with, load_eye_model, simulated_sight
from testbed.lockstep.world import World
from testbed.reporting.console import bars, err, kept_on_ctrl_c, out, table, write_json
from testbed.reporting.plots import AXIS_COLOURS, JOINTS, png
from testbed.scenarios.scenario import Overrides, Settings, load_settings


class TroubleWords(NamedTuple):
    """What happened, and how its value is told: times ``scale`` in ``unit``."""

    what: str
    scale: float
    unit: str


_MRAD = (1e3, "mrad")
_MRAD_S = (1e3, "mrad/s")
_SPOOL = (100.0, "% of the spool")
WORDS = {
    "no_motion": TroubleWords("does not move: a valve stuck or unplugged, or an encoder", *_SPOOL),
    "wrong_way": TroubleWords("turns against its valve word: valve or encoder is swapped", *_MRAD),
    "blocked": TroubleWords("stands still under its open valve: a stop, or something in the way", *_MRAD),
    "oscillates": TroubleWords("swings to and fro: a load-holding valve, or soft oil", 1.0, "reversals"),
    "not_at_rest": TroubleWords("does not come to rest behind its closed valve", *_MRAD_S),
    "too_far": TroubleWords("turned too far in one stroke", *_MRAD),
    "too_fast": TroubleWords("turned too fast", *_MRAD_S),
    "too_slow": TroubleWords("took too long for one stroke", 1.0, "s"),
    "joint_limit": TroubleWords("reached the end of its range", *_MRAD),
    "no_room": TroubleWords("stands too near the end of its range for a stroke", *_MRAD),
    "pressure": TroubleWords("a chamber's pressure is too high", 1.0, "bar"),
    "other_joint_moved": TroubleWords("another joint moved meanwhile", *_MRAD),
}
"""By cause, without its ``commissioning.``."""


def trouble_words(trouble: Trouble) -> str:
    """``cause: joint: what: value, limit``, without a stop at its end."""
    words = WORDS.get(trouble.cause.removeprefix("commissioning."))
    if words is None:  # stopped from outside, or a controller's that knows more than we do
        return f"{trouble.cause}: {JOINT_NAMES[trouble.joint]}"
    value, limit = words.scale * trouble.value, words.scale * trouble.limit
    value_text = f"{value:.4g} {words.unit}, limit {limit:.4g}"
    return f"{trouble.cause}: {JOINT_NAMES[trouble.joint]}: {words.what}: {value_text}"


_OF_EDGES = (
    "joint", "sense", "deadband %", "hysteresis %", "lag ms", "response ms", "flow / nominal", "curve",
    "left mrad",
)  # fmt: skip
_OF_JOINTS = ("joint", "friction bar", "load bar", "half play mrad", "travel mrad", "s")


def findings_tables(found: Mapping[int, JointFindings], seen: TrialsTold | None = None) -> list[Table]:
    """One row an edge, then one a joint; spools in per cent of the full one, numbers ± standard deviation.

    ``seen``: plays that the vision PC told, where no odometry is in the recordings.
    """
    edges = [
        ("" if sense == "lowering" else JOINTS[joint], *_edge_cells(sense, edge))
        for joint, one in sorted(found.items())
        for sense, edge in (("raising", one.raising), ("lowering", one.lowering))
    ]
    plays = {} if seen is None else {str(name): one for name, one in seen.play_mrad.items()}
    joints = [
        (JOINTS[joint], *_joint_cells(one, plays.get(JOINT_NAMES[joint])))
        for joint, one in sorted(found.items())
    ]
    return [
        table("commissioning: valves, value ± standard deviation", _OF_EDGES, edges),
        table("commissioning: joints", _OF_JOINTS, joints),
    ]


_SEEN_BY = {"return": "return edge last", "outlet": "by its outlet", "unknown": "one edge seen"}


def _edge_cells(sense: str, edge: EdgeFindings) -> tuple[str, ...]:
    return (
        sense if edge.last == "supply" else f"{sense}, {_SEEN_BY[edge.last]}",
        _number_text(edge.deadband, 100.0, 3),
        _number_text(edge.hysteresis, 100.0, 2),
        _number_text(edge.lag, 1e3, 0),
        _number_text(edge.response, 1e3, 0),
        _number_text(edge.gain, 1.0, 3),
        f"{edge.curvature:+.2f}",
        f"{1e3 * edge.residual:.3f}",
    )


def _joint_cells(one: JointFindings, by_vision: ToldNumber | None) -> tuple[str, ...]:
    return (
        _number_text(one.friction.friction, 1.0, 1),
        _number_text(one.friction.load, 1.0, 1),
        _play_told(one, by_vision),
        f"{1e3 * one.travel:.0f}",
        f"{one.seconds:.0f}",
    )


def _play_told(one: JointFindings, by_vision: ToldNumber | None) -> str:
    if one.play is None:
        return (
            one.unseen
            if by_vision is None
            else _number_text(Uncertain(by_vision.value, by_vision.std), 1.0, 3)
        )
    half_text = _number_text(Uncertain(one.play.half, one.play.half_std), 1e3, 3)
    return half_text if one.resolved else f"{half_text} (not to 20 %)"


def _number_text(number: Uncertain, unit: float, digits: int) -> str:
    return f"{unit * number.value:.{digits}f} ± {unit * number.std:.{digits}f}"


def findings_figures(found: Mapping[int, JointFindings]) -> dict[str, Any]:
    """The same numbers for a JSON file, SI and bar, by joint."""
    return {JOINTS[joint]: one._asdict() for joint, one in sorted(found.items())}


def joint_figure(recording: JointRecording, found: JointFindings, compensated: bool) -> Figure:
    """Speed over spool of every triangle with the fitted flow, and load pressure over speed."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    flow, load = figure.subplots(1, 2)
    for stroke in strokes_in(recording, compensated):
        if stroke.kind is not StrokeKind.RAMP:
            continue
        speed, sense = smoothed_speed(stroke), stroke.sense
        colour = AXIS_COLOURS[0] if sense > 0.0 else AXIS_COLOURS[1]
        flow.plot(100.0 * sense * stroke.u, 1e3 * sense * speed, color=colour, linewidth=0.6, alpha=0.6)
        load.plot(1e3 * sense * speed, sense * stroke.load, color=colour, linewidth=0.6, alpha=0.6)
    for sense, edge in ((1.0, found.raising), (-1.0, found.lowering)):
        for spool, relative in edge.flow:
            nominal = float(recording.full_speed[:, 0 if sense > 0.0 else 1].mean())
            flow.plot(100.0 * sense * spool, 1e3 * sense * relative * nominal, "ks", markersize=3)
        flow.axvline(100.0 * sense * edge.deadband.value, color="0.4", linestyle="--", linewidth=0.8)
    flow.set_xlabel("spool %")
    flow.set_ylabel("speed mrad/s")
    flow.set_title(f"{JOINTS[recording.joint]}: triangles, steps (squares), deadbands (dashed)", fontsize=9)
    load.set_xlabel("speed mrad/s")
    load.set_ylabel("load pressure bar")
    return figure


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
    progress_text = (
        f"{len(joints) - len(to_do)} joints are in {request.directory}, {len(to_do)} are tried out now"
    )
    out.print(progress_text, style="dim", highlight=False)
    complete = _tried_out(settings, request, to_do, session) if to_do else True
    found = _findings_of(session, settings)
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
        ended = _excite(settings, request, joints, session)
    except (MeasurementFailed, LinkLost) as error:
        return _broken_off(session, error.cause, f"{error.cause}: {error}")
    minutes = ended.seconds / 60.0
    out.print(f"{minutes:.1f} min of arm time, to be below {LONGEST_MIN:g}", highlight=False)
    if ended.trouble is not None:
        return _broken_off(session, ended.trouble.cause, trouble_words(ended.trouble))
    session.ended_by(None)
    return True


def _excite(
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


def _broken_off(session: CommissioningSession, cause: str, why: str) -> bool:
    session.ended_by(cause)
    kept = f"{why}; the arm stands, what was found is kept"
    err.print(kept, style="bold red", highlight=False, soft_wrap=True, markup=False)
    return False


def _findings_of(session: CommissioningSession, settings: Settings) -> dict[int, JointFindings]:
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
    where = f"written: {path}; the controller takes it as controller.commissioned={path.resolve()}"
    out.print(where, highlight=False, soft_wrap=True)
