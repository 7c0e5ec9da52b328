"""`longreach commission`: try the joints out, find the valves, write commissioned.yaml."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import yaml
from rich.table import Table

from controller.core.excitation.plan import Failure
from nominal_arm.description import JOINT_NAMES
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.fault_execution import obey
from plant_emulator.core.faults.schedule import FaultOrder
from protocol.errors import ConfigurationError, LinkLost, LongreachError, MeasurementFailed
from testbed.commissioning.findings import JointFindings, commissioned_from, joint_findings
from testbed.commissioning.ramp_rows import Uncertain
from testbed.commissioning.recording import TrialSession
from testbed.commissioning.runs import excite_in_lockstep, with_excitation
from testbed.commissioning.valve_fit import EdgeFindings
from testbed.lockstep.clock import RunLog
from testbed.lockstep.world import World
from testbed.reporting.console import bars, err, kept_on_ctrl_c, out, table, write_json
from testbed.reporting.plots import JOINTS
from testbed.scenarios.scenario import Overrides, Settings, load_settings

_MRAD = (1e3, "mrad")
_MRAD_S = (1e3, "mrad/s")
_SPOOL = (100.0, "% of the spool")
WORDS = {
    "no_motion": ("does not move: a valve stuck or unplugged, or an encoder", *_SPOOL),
    "wrong_way": ("turns against its valve word: valve or encoder is swapped", *_MRAD),
    "blocked": ("stands still under its open valve: a stop, or something in the way", *_MRAD),
    "oscillates": ("swings to and fro: a load-holding valve, or soft oil", 1.0, "reversals"),
    "not_at_rest": ("does not come to rest behind its closed valve", *_MRAD_S),
    "too_far": ("turned too far in one stroke", *_MRAD),
    "too_fast": ("turned too fast", *_MRAD_S),
    "too_slow": ("took too long for one stroke", 1.0, "s"),
    "joint_limit": ("reached the end of its range", *_MRAD),
    "no_room": ("stands too near the end of its range for a stroke", *_MRAD),
    "pressure": ("a chamber's pressure is too high", 1.0, "bar"),
    "other_joint_moved": ("another joint moved meanwhile", *_MRAD),
}
"""By cause, without its ``commissioning.``: what happened, and scale and unit of its value."""


def failure_words(failure: Failure) -> str:
    """``cause: joint: what: value, limit``, without a stop at its end."""
    words = WORDS.get(failure.cause.removeprefix("commissioning."))
    if words is None:  # stopped from outside, or a controller's that knows more than we do
        return f"{failure.cause}: {JOINT_NAMES[failure.joint]}"
    what, scale, unit = words
    value_text = f"{scale * failure.value:.4g} {unit}, limit {scale * failure.limit:.4g}"
    return f"{failure.cause}: {JOINT_NAMES[failure.joint]}: {what}: {value_text}"


_OF_EDGES = (
    "joint", "sense", "deadband %", "hysteresis %", "lag ms", "flow / nominal", "curve", "left mrad",
)  # fmt: skip


def findings_table(found: Mapping[int, JointFindings]) -> Table:
    """One row an edge; spools in per cent of the full one, numbers ± standard deviation."""
    edges = [
        ("" if sense == "lowering" else JOINTS[joint], *_edge_cells(sense, edge))
        for joint, one in sorted(found.items())
        for sense, edge in (("raising", one.raising), ("lowering", one.lowering))
    ]
    return table("commissioning: valves, value ± standard deviation", _OF_EDGES, edges)


_SEEN_BY = {"return": "return edge last", "outlet": "by its outlet", "unknown": "one edge seen"}


def _edge_cells(sense: str, edge: EdgeFindings) -> tuple[str, ...]:
    return (
        sense if edge.last == "supply" else f"{sense}, {_SEEN_BY[edge.last]}",
        _number_text(edge.deadband, 100.0, 3),
        _number_text(edge.hysteresis, 100.0, 2),
        _number_text(edge.lag, 1e3, 0),
        _number_text(edge.gain, 1.0, 3),
        f"{edge.curvature:+.2f}",
        f"{1e3 * edge.residual:.3f}",
    )


def _number_text(number: Uncertain, unit: float, digits: int) -> str:
    return f"{unit * number.value:.{digits}f} ± {unit * number.std:.{digits}f}"


LONGEST_MIN = 15.0  # of arm time, that commissioning shall stay below


class CommissionRequest(NamedTuple):
    """Which machine, which joints (names), and the directory of trials and result; ``json``: figures as well.

    ``records``: where a controller recorded its own trials, which are taken; nothing is emulated then.
    ``faults``: what of the emulated arm is broken from the start.
    """

    config_dir: Path
    overrides: Overrides
    joints: Sequence[str]
    directory: Path
    seed: int
    json: Path | None
    records: Path | None = None
    faults: tuple[FaultOrder, ...] = ()


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
    live = request.records is not None
    place = request.records or request.directory
    session = TrialSession(place, settings.arm, settings.controller, began=live)
    to_do = [joint for joint in joints if joint not in session.finished]
    progress_text = f"{len(joints) - len(to_do)} joints are in {place}, {len(to_do)} are not"
    out.print(progress_text, style="dim", highlight=False)
    if not to_do:
        complete = True
    elif live:
        names = ", ".join(JOINT_NAMES[joint] for joint in to_do)
        unfinished = f"commissioning.unfinished: {names}: ENABLE begins or goes on"
        complete = _broken_off(failure_words(session.failure) if session.failure else unfinished)
    else:
        complete = _tried_out(settings, request, to_do, session)
    found = _findings_of(session, settings)
    if found:
        out.print(findings_table(found))
    joints_json = {JOINTS[joint]: one._asdict() for joint, one in sorted(found.items())}
    write_json(request.json, {"joints": joints_json, "complete": complete})
    whole = complete and all(joint in found for joint in joints)
    if whole:
        _write(found, settings, session, request.directory)
    return whole


def _joint(name: str) -> int:
    if name not in JOINT_NAMES:
        known = ", ".join(JOINT_NAMES)
        raise ConfigurationError("configuration.unknown_joint", f"no joint '{name}'; known: {known}")
    return JOINT_NAMES.index(name)


def _tried_out(
    settings: Settings, request: CommissionRequest, joints: Sequence[int], session: TrialSession
) -> bool:
    """Whether all ``joints`` were tried out; what broke it off is told and noted, the arm then stands."""
    kept = kept_on_ctrl_c(lambda: f"{len(session.finished)} joints are kept in {request.directory}")
    try:
        with kept, bars() as shown, shown.step("trying out the valves") as bar:
            world = World(with_excitation(settings, joints), request.seed, RunLog())
            for order in request.faults:
                obey(order, world.plant, Scene(settings.scene).cover)
            seconds, failure = excite_in_lockstep(world, session.keep, bar.update)
    except (MeasurementFailed, LinkLost) as error:
        session.ended_by(Failure(error.cause, joints[0], 0.0, 0.0))
        return _broken_off(f"{error.cause}: {error}")
    out.print(f"{seconds / 60.0:.1f} min of arm time, to be below {LONGEST_MIN:g}", highlight=False)
    if failure is None:
        return True
    session.ended_by(failure)
    return _broken_off(failure_words(failure))


def _broken_off(why: str) -> bool:
    kept = f"{why}; the arm stands, what was found is kept"
    err.print(kept, style="bold red", highlight=False, soft_wrap=True, markup=False)
    return False


def _findings_of(session: TrialSession, settings: Settings) -> dict[int, JointFindings]:
    """What the session's recordings say; a joint whose numbers are refused is told, and left out."""
    compensated = settings.controller.valves.pressure_compensated
    found = {}
    for joint, recording in session.recordings().items():
        try:
            found[joint] = joint_findings(recording, compensated)
        except LongreachError as error:
            err.print(f"{error.cause}: {error}", style="bold red", highlight=False)
            continue
    return found


def _write(
    found: Mapping[int, JointFindings], settings: Settings, session: TrialSession, directory: Path
) -> None:
    made = datetime.now(UTC).isoformat(timespec="seconds"), f"longreach commission {version('longreach')}"
    sources = {joint: session.source(joint) for joint in found}
    content = commissioned_from(found, settings.arm, settings.controller, sources, made)
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / "commissioned.yaml"
    path.write_text(yaml.safe_dump(content.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
    where = f"written: {path}; the controller takes it as controller.commissioned={path.resolve()}"
    out.print(where, highlight=False, soft_wrap=True)
