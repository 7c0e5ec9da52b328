"""The reader of the plant's recording. docs/recording.md is the written format."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.recording.contents import contents
from foundation.recording.decoding import messages
from plant_emulator.shell.truth_message import truth_of
from plant_emulator.shell.truth_recorder import (
    CAPTURE,
    FAULT,
    TRUTH,
    FaultMessage,
    TruthRecord,
)


class FaultRecord(NamedTuple):
    """One fault of a run: its kind and parameters, and from when to when it was in force.

    ``began_ns`` and ``ended_ns`` are simulated times, None where it did not; ``log_ns`` is the monotonic time
    at which it began, or at which it was first heard of.
    """

    number: int
    name: str
    fault: dict[str, Any]
    log_ns: int
    began_ns: int | None
    ended_ns: int | None

    def in_force(self, time_ns: int) -> bool:
        """Whether it was in force at the simulated ``time_ns``."""
        has_begun = self.began_ns is not None and self.began_ns <= time_ns
        return has_begun and (self.ended_ns is None or time_ns < self.ended_ns)


class Recording(NamedTuple):
    """What a recording holds, in order of writing. ``complete``: the file was closed, not cut off."""

    truths: tuple[TruthRecord, ...]
    faults: tuple[FaultRecord, ...]
    run: dict[str, Any]
    complete: bool

    def stacked(self, field: str) -> NDArray[np.float64]:
        """One field of every truth as an array (n, …): ``p_CM`` gives (n, 3), ``X_BT`` (n, 4, 4)."""
        return np.array([getattr(record.truth, field) for record in self.truths], dtype=np.float64)

    def log_ns(self) -> NDArray[np.int64]:
        """Monotonic times (n,) of the truths."""
        return np.array([record.log_ns for record in self.truths], dtype=np.int64)


def read_truth(path: Path) -> Recording:
    """The recording at ``path``, also one that a kill cut off: everything up to the cut.

    Raises OSError when the file cannot be read, RecordingUnreadable when it is not MCAP at all.
    """
    truths: list[TruthRecord] = []
    faults: dict[int, FaultRecord] = {}
    for topic, record in messages(path, (FAULT, TRUTH, CAPTURE)):
        if topic == FAULT:
            change = _change(record.data)
            faults[change["number"]] = _further(faults.get(change["number"]), change, record.log_time)
        else:
            truth, frame_id, motion = truth_of(record.data)
            truths.append(TruthRecord(record.log_time, frame_id, truth, motion=motion))
    known = contents(path)
    run = json.loads(known.metadata.get("run", {}).get("configuration", "{}"))
    return Recording(tuple(truths), tuple(faults.values()), run, known.complete)


def _change(data: bytes) -> dict[str, Any]:
    """A step in the life of a fault, as ``FaultChange.as_dict`` told it."""
    message = FaultMessage.FromString(data)
    plain = {field.name: value for field, value in message.ListFields() if field.name != "fault_json"}
    return plain | {"fault": json.loads(message.fault_json)}


def _further(known: FaultRecord | None, change: Mapping[str, Any], log_ns: int) -> FaultRecord:
    """What is known of a fault after one more change of it."""
    known = known or FaultRecord(change["number"], change["name"], change["fault"], log_ns, None, None)
    if change["phase"] == "began":
        return known._replace(log_ns=log_ns, began_ns=change["time_ns"])
    return known._replace(ended_ns=change["time_ns"]) if change["phase"] == "ended" else known
