"""What the controller's own recording says of every scan."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.shell.scan_recorder import STATE, StateMessage
from foundation.recording.decoding import messages
from nominal_arm.description import JOINT_NAMES


class Scans(NamedTuple):
    """Scans (n) in order: monotonic time, the group's state, valve words (n, 6) of full opening."""

    times_ns: NDArray[np.int64]
    states: NDArray[np.int64]
    valves: NDArray[np.float64]


def read_scans(path: Path) -> Scans:
    """All scans in a ``controller.mcap``."""
    rows: list[tuple[int, int, list[float]]] = []
    for _, message in messages(path, {STATE}):
        said: Any = StateMessage.FromString(message.data)
        words = [getattr(said, f"valve_{joint}") for joint in JOINT_NAMES]
        rows.append((message.log_time, said.group_state, words))
    times, states, valves = zip(*rows, strict=True)
    return Scans(np.array(times), np.array(states), np.array(valves))
