"""Watching a controller try out its valves: the play of each joint and the camera's delay, by odometry.

The controller must have been started in its excitation mode (``controller.excitation.enabled``): ENABLE then
begins, and the group shows MOVING until all of its joints are done. Vision commands nothing else.
"""

import itertools
from typing import NamedTuple

import numpy as np

from nominal_arm.description import JOINT_NAMES
from protocol.errors import LinkLost, MeasurementFailed, RequestRefused
from protocol.faults import CommandCode, GroupState
from protocol.reference_messages import State
from vision_pc.application.application import VisionApplication
from vision_pc.application.results import JSON
from vision_pc.core.calibration.joint_motion import JointSeen
from vision_pc.core.calibration.joint_play import PlayFound, joint_play, mean_delay
from vision_pc.core.ports import Report
from vision_pc.core.types import WatchSample

_BEGINS_STATES = 400  # within which the group must show MOVING
_TOLD = 10  # pictures between two notes of progress: the trials take minutes
_SILENT_S = 15.0  # of the camera, until the trials are given up


class TrialsSeen(NamedTuple):
    """What odometry saw of each joint that was tried out: its play, or why it was not found (by name)."""

    plays: dict[str, PlayFound]
    unseen: dict[str, str]


async def watch_trials(application: VisionApplication, report: Report) -> TrialsSeen:
    """Enable the arm, watch until its controller has tried out its valves, and disable it.

    A camera that is silent for less than ``_SILENT_S`` costs the joint that was tried out meanwhile, no more.
    Raises RequestRefused (``refused.no_trials``): the controller is in no such mode, which it tells without
    being enabled, or nothing begins to move, for it has finished; what ``Eyes.watch`` raises; LinkLost.
    """
    controller = application.controller
    if controller.connected and not controller.tries_valves:
        raise RequestRefused("refused.no_trials", "the controller was not started to try out its valves")
    states: list[State] = []
    stretches: list[tuple[WatchSample, ...]] = []
    while not states or controller.state.group_state is GroupState.MOVING:
        try:
            await _watch(application, states, stretches, report)
        except LinkLost as lost:
            silent = lost.cause in ("link.camera_silent", "link.camera_frozen")
            if not (silent and states) or controller.state.time_ns - states[-1].time_ns > 1e9 * _SILENT_S:
                raise
    await _disabled(application)
    offset = controller.clock_offset
    if offset is None:
        raise LinkLost("link.no_clock", "the controller's clock is not known yet")
    return seen_of(states, stretches, offset.offset_ns)


async def _watch(
    application: VisionApplication,
    states: list[State],
    stretches: list[tuple[WatchSample, ...]],
    report: Report,
) -> None:
    """Add the ``states`` from here on, and at the end what odometry saw, from one first picture on.

    The first time it begins the trials. Raises what ends the watching, such as LinkLost.
    """
    controller, at = application.controller, 0
    async with application.eyes.watch(markers=False, odometry=True) as watch:
        try:
            if not states:
                await controller.command(CommandCode.ENABLE)
                await _wait_for_start(application)
            state = controller.state
            while state.group_state is GroupState.MOVING:
                states.append(state)
                if np.any(state.valves):
                    at = int(np.argmax(np.abs(state.valves)))
                await watch.after(len(watch.samples), 0.0)  # raises what ended the watching
                seen = sum(map(len, stretches)) + len(watch.samples)
                report(min(0.05 + 0.15 * at, 0.95), f"{JOINT_NAMES[at]}: {seen - seen % _TOLD} pictures")
                state = await controller.next_state()
        finally:
            stretches.append(watch.samples)


async def _disabled(application: VisionApplication) -> None:
    """Return once the arm stands, disabled or with its fault latched."""
    controller = application.controller
    await controller.command(CommandCode.DISABLE)
    while controller.state.group_state in (GroupState.MOVING, GroupState.STOPPING, GroupState.STANDBY):
        await controller.next_state()


async def _wait_for_start(application: VisionApplication) -> None:
    for _ in range(_BEGINS_STATES):
        if (await application.controller.next_state()).group_state is GroupState.MOVING:
            return
    await _disabled(application)
    raise RequestRefused(
        "refused.no_trials",
        "the controller is enabled and nothing moves: it has tried out all that it was started for",
    )


def seen_of(states: list[State], stretches: list[tuple[WatchSample, ...]], offset_ns: int) -> TrialsSeen:
    """The plays by the ``states`` of the trials; ``offset_ns``: the controller's clock minus the samples'.

    Each of the ``stretches`` has poses from a first picture of its own; no picture came between them.
    """
    t = 1e-9 * np.array([state.time_ns - states[0].time_ns for state in states])
    q = np.array([state.q_meas for state in states])
    valves = np.array([state.valves for state in states])
    watched = [
        [(1e-9 * (s.time_ns + offset_ns - states[0].time_ns), s.X_C0C) for s in each] for each in stretches
    ]
    watched = [each for each in watched if each]
    gaps = [(before[-1][0], after[0][0]) for before, after in itertools.pairwise(watched)]
    found = TrialsSeen({}, {})
    for joint, name in enumerate(JOINT_NAMES):
        rows = np.flatnonzero(np.abs(valves[:, joint]) > 0.0)
        if len(rows) == 0:
            continue
        span = slice(rows[0], rows[-1] + 1)
        begin, end = t[rows[0]], t[rows[-1]]
        mine = [(at, X) for each in watched for at, X in each if X is not None and begin <= at <= end]
        try:
            _refuse_gap(gaps, begin, end)
            found.plays[name] = joint_play(
                JointSeen(
                    joint,
                    t[span],
                    q[span],
                    valves[span, joint],
                    np.array([at for at, _ in mine]),
                    np.array([X for _, X in mine]).reshape(-1, 4, 4),
                )
            )
        except MeasurementFailed as error:
            found.unseen[name] = str(error)
    return found


def _refuse_gap(gaps: list[tuple[float, float]], begin: float, end: float) -> None:
    for last, first in gaps:
        if last < end and first > begin:
            raise MeasurementFailed(
                "measurement.camera_silent", f"no picture for {first - last:.1f} s while it was tried out"
            )


def trials_json(seen: TrialsSeen) -> JSON:
    """Half the plays in mrad and the camera's delay in ms, each with its σ."""
    delay = None
    if seen.plays:
        late, std = mean_delay(list(seen.plays.values()))
        delay = {"value": 1e3 * late, "std": 1e3 * std}
    return {
        "play_mrad": {
            name: {"value": 1e3 * play.half, "std": 1e3 * play.half_std} for name, play in seen.plays.items()
        },
        "unseen": seen.unseen,
        "camera_delay_ms": delay,
    }
