"""What the controller's own recording, every scan of it, says of stops that were asked for."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.shell.scan_recorder import STATE, StateMessage
from foundation.recording.decoding import messages
from nominal_arm.description import JOINT_NAMES
from protocol.faults import GroupState

RESTED_S = 1.0
"""After so long in standby what the valves do counts as standby's own."""


class Scans(NamedTuple):
    """Scans (n) in order: monotonic time, the group's state, valve words (n, 6) of full opening."""

    times_ns: NDArray[np.int64]
    states: NDArray[np.int64]
    valves: NDArray[np.float64]


class StopTimes(NamedTuple):
    """Milliseconds after a stop was asked for; None where the recording does not show it.

    ``answered``: the first scan whose outputs are the stop's. ``stood``: the first one after it whose desired
    motion has come to rest. ``settled``: from when on, until the next motion, no valve opens further than
    standby opens it by itself to hold the arm.
    """

    answered: float | None
    stood: float | None
    settled: float | None


def read_scans(path: Path) -> Scans:
    """All scans in a ``controller.mcap``."""
    rows: list[tuple[int, int, list[float]]] = []
    for _, message in messages(path, {STATE}):
        said: Any = StateMessage.FromString(message.data)
        words = [getattr(said, f"valve_{joint}") for joint in JOINT_NAMES]
        rows.append((message.log_time, said.group_state, words))
    times, states, valves = zip(*rows, strict=True)
    return Scans(np.array(times), np.array(states), np.array(valves))


def standby_openings(scans: Scans) -> NDArray[np.float64]:
    """How far standby opens each valve at most (6,), once it has lasted ``RESTED_S``."""
    standby = scans.states == GroupState.STANDBY
    begun_ns = np.maximum.accumulate(np.where(standby, -1, scans.times_ns))  # the last scan of another state
    rested = standby & (scans.times_ns - begun_ns >= 1e9 * RESTED_S)
    return np.asarray(np.abs(scans.valves[rested]).max(axis=0))


def stop_times(scans: Scans, asked_ns: float, until_ns: float, openings: NDArray[np.float64]) -> StopTimes:
    """Of the stop that was asked for at ``asked_ns`` in a motion, by what was recorded to ``until_ns``."""
    begin, end = np.searchsorted(scans.times_ns, [asked_ns, until_ns])
    times_ns, states, valves = (each[begin:end] for each in scans)

    def first(happened: NDArray[np.bool_], since: int) -> int | None:
        found = np.flatnonzero(happened[since:])
        return int(found[0]) + since if len(found) else None

    def after_ms(index: int | None) -> float | None:
        return None if index is None else 1e-6 * float(times_ns[index] - asked_ns)

    answered = first(states == GroupState.STOPPING, 0)
    stood = None if answered is None else first(states != GroupState.STOPPING, answered)
    if stood is None or states[stood] != GroupState.STANDBY:
        return StopTimes(after_ms(answered), None, None)
    ended = first(states != GroupState.STANDBY, stood) or len(states)
    restless = np.flatnonzero(np.any(np.abs(valves[stood:ended]) > openings, axis=1))
    settled = stood + int(restless[-1]) + 1 if len(restless) else stood
    return StopTimes(after_ms(answered), after_ms(stood), after_ms(settled if settled < ended else None))
