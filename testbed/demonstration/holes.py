"""The demonstration on a wall without markers: three drill holes, found, clicked and driven to in order."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from plant_emulator.core.truth import PlantTruth
from protocol.errors import MeasurementFailed
from testbed.demonstration.sequence import AROUND_NS, Clicked, Recorder, Rest, Rig, TimedTruth
from testbed.reporting.outcome import Array

HOLES = 3


class SeenHole(NamedTuple):
    """A hole that was detected: its middle in the left picture, px (2,), and in C (3,)."""

    pixel: Array
    p_C: Array


class HoleRig(Rig, Protocol):
    """A rig that knows targets without markers."""

    def holes(self) -> list[tuple[Array, Array]]:
        """All holes of the newest picture: middle in the left eye's, px (2,), and in C (3,)."""
        ...

    def target_at(self, pixel: Array) -> str:
        """The id of the hole at ``pixel`` of a fresh left picture, from now on a target."""
        ...


def visit_holes(rig: HoleRig, recorder: Recorder) -> None:
    """Find the holes, click the three in the middle of them, and drive to each, from left to right.

    Raises MeasurementFailed (``target.no_hole``) where fewer are seen, and what stopped it.
    """
    rig.command("enable")
    seen = [SeenHole(*hole) for hole in rig.holes()]
    if len(seen) < HOLES:
        raise MeasurementFailed("target.no_hole", f"demo: {len(seen)} holes are seen, {HOLES} are wanted")
    clicked = []
    for hole in chosen(seen):
        target = rig.target_at(hole.pixel)
        clicked.append((target, Clicked(rig.now_ns(), hole.p_C)))
    for number, (target, click) in enumerate(clicked, 1):
        recorder.step(
            f"hole {number} ({target})", "visit", {"targets": [target]}, look_number=number, clicked=click
        )


def chosen(seen: Sequence[SeenHole]) -> list[SeenHole]:
    """The three nearest to the middle of all, from left to right."""
    middle = np.mean([hole.p_C for hole in seen], axis=0)
    nearest = sorted(seen, key=lambda hole: float(np.linalg.norm(hole.p_C - middle)))[:HOLES]
    return sorted(nearest, key=lambda hole: float(hole.pixel[0]))


def aimed_truths(truths: Sequence[TimedTruth], rests: Sequence[Rest], holes_O: Array) -> list[TimedTruth]:
    """``truths`` with the object in the true hole that was driven to then: the hole nearest to the click.

    ``holes_O`` (n, 3): true middles in O. Without clicks they stay as they are.
    """
    goals = [
        (rest.time_ns + AROUND_NS, _true_hole(rest.clicked, truths, holes_O))
        for rest in rests
        if rest.clicked is not None
    ]
    if not goals:
        return list(truths)
    return [
        timed._replace(
            truth=_moved(timed.truth, next((p for end, p in goals if timed.time_ns <= end), goals[-1][1]))
        )
        for timed in truths
    ]


def _true_hole(clicked: Clicked, truths: Sequence[TimedTruth], holes_O: Array) -> Array:
    times = np.array([timed.time_ns for timed in truths], dtype=np.int64)
    truth = truths[int(np.abs(times - clicked.time_ns).argmin())].truth
    places = holes_O @ truth.R_CO.T + truth.p_CO
    return np.asarray(holes_O[int(np.linalg.norm(places - clicked.p_C, axis=1).argmin())])


def _moved(truth: PlantTruth, place_O: Array) -> PlantTruth:
    return truth._replace(p_CO=truth.p_CO + truth.R_CO @ place_O)
