"""`longreach replay`: vision's recording run again, compared to the last bit or with other settings."""

import contextlib
import time
from collections import deque
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from foundation.configuration import parse_overrides
from foundation.recording.beginning import session_entries
from foundation.recording.decoding import Damage
from protocol.errors import ConfigurationError
from testbed.recordings.comparison import ALIKE, ReplayComparison
from testbed.recordings.decision_replay import DecisionReplay
from testbed.recordings.perception_replay import (
    LOOK,
    OBSERVATION,
    ODOMETRY,
    PerceptionReplay,
    pixels_for,
)
from testbed.recordings.pixels import RenderedAhead, RenderedPixels, rendered_ahead
from testbed.recordings.recorded_vision import RecordedVision, recorded_vision
from testbed.reporting.console import out, table, write_json
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


class ReplayRequest(NamedTuple):
    """What is replayed, from whose pictures, with which other settings, and where the results go.

    ``decisions``: programs alone, for which no picture is needed. ``ahead``: pictures that must be rendered
    are by another process; it starts as multiprocessing's do, so a script that asks for it needs a guarded
    main module.
    """

    file: Path
    truth: Path | None
    settings: list[str]
    plot: Path | None
    json_file: Path | None
    decisions: bool = False
    ahead: bool = False


def run_replay(request: ReplayRequest) -> bool:
    """Whether all came out as recorded; with other settings, whether it could be run.

    Raises RecordingUnreadable, ConfigurationError, OSError.
    """
    overrides = parse_overrides(request.settings)
    if others := sorted(set(overrides) - {"vision"}):
        raise ConfigurationError(
            "configuration.unknown_file", f"--set {others[0]}…: a replay has the settings of vision alone"
        )
    if overrides and request.decisions:
        raise ConfigurationError(
            "configuration.decisions_what_if", "--set changes what is measured; --decisions measures nothing"
        )
    recording = recorded_vision(request.file, overrides.get("vision"))
    figures: dict[str, Any] = {}
    compared: list[ReplayComparison] = []
    damages: tuple[Damage, ...] = ()
    if recording.pictured and not request.decisions:
        replayed = _replay_perception(recording, request, bool(overrides), figures)
        compared.append(replayed.comparison)
        damages = tuple(replayed.damages)
    if not overrides:
        decided = _replay_decisions(recording, figures)
        compared.append(decided.comparison)
        damages = damages or tuple(decided.damages)
        _show_compared(compared, recording)
    for damage in damages:
        out.print(f"not read, at byte {damage.offset}: {damage.what}", highlight=False)
    write_json(request.json_file, figures | {"damages": [damage._asdict() for damage in damages]})
    return bool(overrides) or (all(each.identical for each in compared) and not damages)


def _replay_perception(
    recording: RecordedVision, request: ReplayRequest, what_if: bool, figures: dict[str, Any]
) -> PerceptionReplay:
    pixels = pixels_for(recording, request.truth)
    moved = WhatIf()
    times_ns: deque[int] = deque(maxlen=1)
    began_s, first_ns = time.process_time(), list[int]()

    def advanced(log_ns: int) -> None:
        times_ns.append(log_ns)
        if not first_ns:
            first_ns.append(log_ns)

    in_turn = rendered_ahead(pixels, recording.path) if request.ahead else contextlib.nullcontext(pixels)
    with in_turn as ahead:
        replay = PerceptionReplay(recording, ahead, moved.take)
        compared = replay.run(advanced)
    took_s = time.process_time() - began_s
    recorded_s = 1e-9 * (times_ns[0] - first_ns[0]) if first_ns else 0.0
    made = "rendered again" if isinstance(pixels, RenderedPixels) else "as recorded"
    beside_s = ahead.cpu_s if isinstance(ahead, RenderedAhead) else 0.0
    told = f"{recorded_s:.1f} s of arm time in {took_s:.1f} s of one core"
    out.print(f"{told} and {beside_s:.1f} s of another; pixels {made}", highlight=False)
    figures |= {"recorded_s": recorded_s, "cpu_s": took_s, "cpu_beside_s": beside_s, "pixels": made}
    figures |= _figures(compared)
    if what_if:
        figures["moved"] = _tell_moved(moved, request.plot)
    return replay


def _replay_decisions(recording: RecordedVision, figures: dict[str, Any]) -> DecisionReplay:
    replay = DecisionReplay(recording)
    compared = replay.run()
    for why, count in replay.not_run.items():
        out.print(f"not run again, {count}: {why}", highlight=False)
    if replay.commands:
        out.print(f"commands that no program decided, while one ran: {replay.commands}", highlight=False)
    figures["decisions"] = {
        "not_run": dict(replay.not_run),
        "commands": replay.commands,
        **_figures(compared),
    }
    return replay


def _figures(compared: ReplayComparison) -> dict[str, Any]:
    return {
        "exact": compared.exact,
        "alike": dict(compared.alike),
        "of": dict(compared.of),
        "largest_difference": compared.largest,
        "first_difference": None if compared.first is None else compared.first._asdict(),
    }


def _tell_moved(what_if: WhatIf, plot: Path | None) -> list[Any]:
    rows = what_if.table()
    _show_moved(rows)
    if plot is not None:
        what_if.plot(plot)
        out.print(f"plot: {plot}", highlight=False)
    return [row._asdict() for row in rows]


def _show_compared(each: list[ReplayComparison], recording: RecordedVision) -> None:
    word = "identical" if recording.exact else f"alike within {ALIKE:g}"
    for compared in each:
        for kind, count in compared.of.items():
            out.print(f"{kind}: {compared.alike[kind]} of {count} {word}", highlight=False)
        if compared.first is not None:
            told = f"first difference: {compared.first.in_words()}"
            out.print(told, highlight=False, soft_wrap=True)
    if not recording.exact:
        versions = _versions(recording)
        out.print(f"not compared to the last bit, as versions differ: {versions}", highlight=False)


def _versions(recording: RecordedVision) -> str:
    here = session_entries("vision_pc", {})
    differing = [name for name in here if name.startswith("version") or name == "machine"]
    told = [
        f"{name.removeprefix('version ')} {recording.session.get(name, 'unknown')}, here {here[name]}"
        for name in differing
        if recording.session.get(name) != here[name]
    ]
    return "; ".join(told)


def _show_moved(rows: list[Moved]) -> None:
    shown = [
        (row.what, row.recorded, row.replayed, *(_millimetres(mm) for mm in (row.median_mm, row.largest_mm)))
        for row in rows
    ]
    columns = ("measured", "recorded", "replayed", "moved by, median mm", "largest mm")
    out.print(table("with other settings, over the same pixels", columns, shown))


def _millimetres(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"
