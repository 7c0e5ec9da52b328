"""The excitation of joints by a running controller: enabled over its own link, found in its records."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from controller.commissioning import basis_of
from controller.core.excitation.plan import Stroke, StrokeKind, Trouble
from controller.core.excitation.program import ExcitationSample
from nominal_arm.description import JOINT_NAMES
from protocol.errors import ConfigurationError, LinkLost, MeasurementFailed
from protocol.faults import CommandCode, GroupState, Reason
from testbed.commissioning.lockstep_run import Excited
from testbed.commissioning.recording import JointRecording, recording_of
from testbed.realtime.live_client import LiveClient
from testbed.scenarios.settings import Settings

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
    told = _last_summary(controller.records, expected)
    _keep(controller.records, told, settings, keep)
    return Excited(seconds, _trouble_of(told))


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
        told: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        basis = told["basis"]
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
    return told


def _last_summary(records: Path, expected: dict[str, Any]) -> dict[str, Any]:
    """The summary once the last recording is written: it says how it ended."""
    until_s = time.monotonic() + _WRITTEN_S
    while True:
        told = _summary(records, expected)
        if told["ended_by"] is not None or told["whole"]:
            return told
        if time.monotonic() > until_s:
            why = f"the valves are centred, and no recording was written within {_WRITTEN_S:g} s"
            raise MeasurementFailed("measurement.stopped", why)
        time.sleep(0.1)


def _keep(
    records: Path, told: dict[str, Any], settings: Settings, keep: Callable[[JointRecording], None]
) -> None:
    for name in told["finished"]:
        strokes, samples = read_trial(records / f"trial_{name}.jsonl")
        keep(recording_of(settings.arm, JOINT_NAMES.index(name), strokes, samples))


def _trouble_of(told: dict[str, Any]) -> Trouble | None:
    ended = told["ended_by"]
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
