"""The excitation of commissioning, run in lockstep or on a live controller, and what ends it."""

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from controller.commissioning import basis_of
from controller.core.excitation.plan import Stroke, StrokeKind, Trouble
from controller.core.excitation.program import ExcitationSample
from nominal_arm.description import JOINT_NAMES
from protocol.errors import ConfigurationError, LinkLost, MeasurementFailed
from protocol.faults import CommandCode, GroupState, Reason
from testbed.commissioning.recording import JointRecording, SeenPose, recording_of
from testbed.lockstep.clock import run
from testbed.lockstep.world import World
from testbed.realtime.live_client import LiveClient
from testbed.scenarios.scenario import Settings
from vision_pc.core.ports import Eyes
from vision_pc.core.types import WatchSample

_LONGEST_S = 3600.0


class Excited(NamedTuple):
    """How an excitation ended: arm time (s), and what broke it off."""

    seconds: float
    trouble: Trouble | None


def with_excitation(settings: Settings, joints: Sequence[int]) -> Settings:
    """``settings`` whose controller starts in the excitation mode, for these joints in this order."""
    mode = settings.controller.excitation.model_copy(update={"enabled": True, "joints": tuple(joints)})
    return settings._replace(controller=settings.controller.model_copy(update={"excitation": mode}))


def excite_in_lockstep(
    world: World,
    keep: Callable[[JointRecording], None],
    progress: Callable[[float, str], None],
    eyes: Eyes | None = None,
) -> Excited:
    """Enable the arm of ``world`` and let its joints be tried out; ``keep`` gets each that is finished.

    ``eyes``: whose odometry watches meanwhile. Raises MeasurementFailed (``measurement.stopped``) when
    somebody else stopped the arm, LinkLost when the reference link does not open.
    """
    world.connect()
    if not world.connected:
        raise LinkLost("link.controller_missing", "the controller does not answer")
    if eyes is None:
        return _excite(world, keep, progress, tuple)
    return run(_excite_watched(world, keep, progress, eyes))


async def _excite_watched(
    world: World, keep: Callable[[JointRecording], None], progress: Callable[[float, str], None], eyes: Eyes
) -> Excited:
    """As ``_excite``; odometry that saw nothing at all does not spoil what the valves said."""
    done: Excited | None = None
    try:
        async with eyes.watch(markers=False, odometry=True) as watch:
            offset_ns = world.link.local_time_ns(0)
            done = _excite(world, keep, progress, lambda: _odometry_poses(watch.samples, offset_ns))
    except MeasurementFailed:
        if done is None:
            raise
    return done


def _odometry_poses(samples: Sequence[WatchSample], offset_ns: int) -> list[SeenPose]:
    """The poses that odometry found, on the controller's clock."""
    return [SeenPose(s.time_ns - offset_ns, s.X_C0C) for s in samples if s.X_C0C is not None]


def _excite(
    world: World,
    keep: Callable[[JointRecording], None],
    progress: Callable[[float, str], None],
    seen: Callable[[], Sequence[SeenPose]],
) -> Excited:
    controller, plan = world.controller, world.controller.plan
    assert plan is not None  # with_excitation
    run(world.link.command(CommandCode.ENABLE))
    began_ns, kept = world.time_ns, 0
    while True:
        world.clock.advance()
        program = controller.excitation
        while kept < program.stroke:
            joint = plan.strokes[kept].joint
            keep(recording_of(world.settings.arm, joint, plan.strokes, controller.samples, seen()))
            kept = _after(plan.strokes, kept)
            progress(kept / len(plan.strokes), f"{1e-9 * (world.time_ns - began_ns):.0f} s of arm time")
        seconds = 1e-9 * (world.time_ns - began_ns)
        if program.finished(plan) or program.trouble is not None:
            _rest(world)
            return Excited(seconds, program.trouble)
        if program.excitation is None and program.inner.fault.code:
            fault = program.inner.fault
            _rest(world)
            raise MeasurementFailed(
                "measurement.stopped", f"fault {fault.code.name.lower()} after {seconds:.1f} s"
            )
        if seconds > _LONGEST_S:
            raise MeasurementFailed("measurement.stopped", f"no end after {seconds:.0f} s")


def _after(strokes: Sequence[Stroke], index: int) -> int:
    """The first stroke of the next joint."""
    joint = strokes[index].joint
    while index < len(strokes) and strokes[index].joint == joint:
        index += 1
    return index


def _rest(world: World) -> None:
    """Until the group stands, its valves centred; then it is disabled."""
    world.clock.advance_until(lambda: world.states[-1].group_state is not GroupState.MOVING, 2.0)
    run(world.link.command(CommandCode.DISABLE))
    world.clock.advance()


SUMMARY = "trials.json"
_BEGINS_S = 10.0
_WRITTEN_S = 30.0  # a recording of a minute, on a busy machine
_LOOK_S = 0.5  # between looks at what was written


class LiveController(NamedTuple):
    """A controller in its excitation mode: where its link is, and the directory that it records in."""

    host: str
    port: int
    records: Path


def excite_live(
    controller: LiveController,
    settings: Settings,
    keep: Callable[[JointRecording], None],
    progress: Callable[[float, str], None],
) -> Excited:
    """Enable the arm and let its controller try out its joints; ``keep`` gets each that is finished.

    Whatever ends this early (Ctrl-C too) stops and disables the arm. Raises ConfigurationError
    (``commissioning.link_taken``, ``.no_trials``, ``.other_session``, ``.bad_recording``), LinkLost when the
    controller is silent, MeasurementFailed (``measurement.stopped``) when somebody else stopped it.
    """
    expected = basis_of(settings.arm, settings.controller).model_dump()
    _summary(controller.records, expected)
    began_s = time.monotonic()
    with LiveClient(controller.host, controller.port) as client:
        _connect(client)
        try:
            _enable(client)
            while _moving(client):
                client.pump(_LOOK_S)  # nothing long in between: a silent link stops the arm
                done = len(_summary(controller.records, expected)["finished"])
                progress(done / len(JOINT_NAMES), f"{time.monotonic() - began_s:.0f} s of arm time")
        finally:
            seconds = time.monotonic() - began_s
            _disable(client)
            _keep(controller.records, _summary(controller.records, expected), settings, keep)
    summary = _last_summary(controller.records, expected)
    _keep(controller.records, summary, settings, keep)
    return Excited(seconds, _trouble_of(summary))


def take_finished(records: Path, settings: Settings, keep: Callable[[JointRecording], None]) -> None:
    """``keep`` gets each joint that is finished in ``records``, whoever had the valves tried out.

    Raises ConfigurationError as ``excite_live`` does.
    """
    expected = basis_of(settings.arm, settings.controller).model_dump()
    _keep(records, _summary(records, expected), settings, keep)


def _connect(client: LiveClient) -> None:
    try:
        client.connect()
    except LinkLost as error:
        if error.cause != "link.occupied":
            raise
        raise ConfigurationError(
            "commissioning.link_taken",
            f"{error}, such as the vision PC of `longreach up`: end that, or let it try the valves out "
            "(POST /operations/valve-trials) and run this again with --seen",
        ) from error


def _enable(client: LiveClient) -> None:
    answer = client.command(CommandCode.ENABLE)
    if answer not in (Reason.ACCEPTED, Reason.ALREADY_DONE):
        raise MeasurementFailed("measurement.stopped", f"ENABLE refused: {answer.name.lower()}")
    try:
        client.until(lambda state: state.group_state is GroupState.MOVING, _BEGINS_S)
    except LinkLost as error:
        raise ConfigurationError(
            "commissioning.no_trials",
            f"the controller is enabled and nothing moves within {_BEGINS_S:g} s: start it with "
            "controller.excitation.enabled=true, and joints that are not finished",
        ) from error


def _moving(client: LiveClient) -> bool:
    """Whether valves are still tried out. Raises LinkLost when the session ended."""
    if not client.connected or client.state is None:
        raise LinkLost("link.silent", "the controller's session ended; it has centred all valves")
    return client.state.group_state is GroupState.MOVING


def _disable(client: LiveClient) -> None:
    if client.connected:
        for code in (CommandCode.STOP, CommandCode.DISABLE):
            client.command(code)


def _summary(records: Path, expected: dict[str, Any]) -> dict[str, Any]:
    path = records / SUMMARY
    try:
        summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        basis = summary["basis"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(
            "commissioning.no_trials",
            f"{path}: {error}; start the controller with controller.excitation.enabled=true and "
            "--record-dir, and name that directory",
        ) from error
    if basis != expected:
        raise ConfigurationError(
            "commissioning.other_session", f"{path}: the controller runs with {basis}, here is {expected}"
        )
    return summary


def _last_summary(records: Path, expected: dict[str, Any]) -> dict[str, Any]:
    """The summary once the last recording is written: it says how it ended."""
    until_s = time.monotonic() + _WRITTEN_S
    while True:
        summary = _summary(records, expected)
        if summary["ended_by"] is not None or summary["whole"]:
            return summary
        if time.monotonic() > until_s:
            why = f"the valves are centred, and no recording was written within {_WRITTEN_S:g} s"
            raise MeasurementFailed("measurement.stopped", why)
        time.sleep(0.1)


def _keep(
    records: Path, summary: dict[str, Any], settings: Settings, keep: Callable[[JointRecording], None]
) -> None:
    for name in summary["finished"]:
        strokes, samples = read_trial(records / f"trial_{name}.jsonl")
        keep(recording_of(settings.arm, JOINT_NAMES.index(name), strokes, samples))


def _trouble_of(summary: dict[str, Any]) -> Trouble | None:
    ended = summary["ended_by"]
    if ended is None:
        return None
    joint = JOINT_NAMES.index(ended["joint"])
    return Trouble(ended["cause"], joint, float(ended["value"]), float(ended["limit"]))


def read_trial(path: Path) -> tuple[list[Stroke], list[ExcitationSample]]:
    """The strokes and the scans in a controller's recording of one joint.

    Raises ConfigurationError (``commissioning.bad_recording``) when it is none.
    """
    try:
        with path.open(encoding="utf-8") as file:
            header = json.loads(file.readline())
            rows = [json.loads(line) for line in file]
        strokes = [Stroke(each[0], StrokeKind(each[1]), *each[2:]) for each in header["strokes"]]
        return strokes, [ExcitationSample(*row) for row in rows]
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ConfigurationError("commissioning.bad_recording", f"{path}: {error}") from error
