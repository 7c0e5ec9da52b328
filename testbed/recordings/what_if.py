"""How far measurements move with other settings, over the same pixels: a table and a plot."""

from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from testbed.recordings.perception_replay import LOOK, OBSERVATION, ODOMETRY
from testbed.reporting.plots import AXIS_COLOURS, STYLE
from vision_pc.shell.recording import vision_messages as own

_PLACES = {
    (OBSERVATION, "p_CM"): ("tool in a frame", own.ObservationMessage),
    (OBSERVATION, "p_CO"): ("object in a frame", own.ObservationMessage),
    (ODOMETRY, "p_C0C"): ("camera by odometry", own.OdometryMessage),
    (LOOK, "p_CM"): ("tool in a look", own.LookMessage),
    (LOOK, "p_CO"): ("object in a look", own.LookMessage),
}
Points = NDArray[np.float64]


class Moved(NamedTuple):
    """What became of one kind of place: how often it was measured before, now, and both times, and how far
    it moved then (mm, median and largest).
    """

    what: str
    recorded: int
    replayed: int
    both: int
    median_mm: float | None
    largest_mm: float | None


class WhatIf:
    """Gathers places from recorded messages and from those that came out again."""

    def __init__(self) -> None:
        self._places: dict[tuple[str, str], list[tuple[int, Points, Points]]] = {key: [] for key in _PLACES}

    def take(self, kind: str, recorded: Any, replayed: bytes) -> None:
        """Keep the places of one message and of what came out again."""
        for key, (_, message) in _PLACES.items():
            if key[0] == kind:
                again = message.FromString(replayed)
                stamp = recorded.time_ns if kind == LOOK else recorded.capture_ns
                self._places[key].append((stamp, _point(recorded, key[1]), _point(again, key[1])))

    def table(self) -> list[Moved]:
        """A row for each kind of place that was measured at all."""
        rows = []
        for key, (what, _) in _PLACES.items():
            _, before, now = self._series(key)
            there = [~np.isnan(points).any(axis=1) for points in (before, now)]
            both = there[0] & there[1]
            if there[0].any() or there[1].any():
                mm = 1e3 * np.linalg.norm((now - before)[both], axis=1)
                figures = (float(np.median(mm)), float(mm.max())) if len(mm) else (None, None)
                rows.append(Moved(what, int(there[0].sum()), int(there[1].sum()), int(both.sum()), *figures))
        return rows

    def plot(self, path: Path) -> None:
        """Write how far each kind of place moved along the recording, axis by axis, to ``path``."""
        shown = [key for key in _PLACES if len(self._series(key)[0]) and key[0] != LOOK]
        with matplotlib.rc_context(STYLE):
            figure = Figure(figsize=(7.0, 1.9 * max(len(shown), 1)), layout="constrained")
            panels = figure.subplots(max(len(shown), 1), 1, squeeze=False, sharex=True)[:, 0]
            for axes, key in zip(panels, shown, strict=False):
                stamps, before, now = self._series(key)
                for axis, colour in enumerate(AXIS_COLOURS):
                    moved = 1e3 * (now - before)[:, axis]
                    axes.plot(
                        1e-9 * (stamps - stamps[0]), moved, ".-", color=colour, label="xyz"[axis], lw=0.8
                    )
                axes.set_ylabel("mm")
                axes.set_title(f"{_PLACES[key][0]}: replayed minus recorded", loc="left")
            if shown:
                panels[0].legend(ncols=3, loc="upper right")
            panels[-1].set_xlabel("s")
            figure.savefig(path)

    def _series(self, key: tuple[str, str]) -> tuple[NDArray[np.int64], Points, Points]:
        places = self._places[key]
        stamps = np.array([stamp for stamp, _, _ in places], dtype=np.int64)
        before, now = (np.array([place[side] for place in places]).reshape(-1, 3) for side in (1, 2))
        return stamps, before, now


def _point(message: Any, name: str) -> Points:
    fields = [f"{name}_{axis}_m" for axis in "xyz"]
    there = all(message.HasField(field) for field in fields)
    return np.array([getattr(message, field) if there else np.nan for field in fields])
