"""The demonstration as a sequence of operations, the same over the REST API and in lockstep.

Orientation adjustment, local calibration, then look-then-moves, with a look wherever the arm comes to rest.
What was true at those times is found out afterwards, from the plant's own recording.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from nominal_arm.description import NominalArm
from nominal_arm.dimensions import dh_links
from plant_emulator.core.truth import PlantTruth, tool_error
from protocol.errors import MeasurementFailed
from testbed.reporting.console import Bar, Bars
from testbed.reporting.outcome import Array, Errors, Stage
from testbed.reporting.plots import TracedView, Traces
from testbed.reporting.report import Picture
from testbed.scenarios.scenario import NamedRequest
from vision_pc.application.visit import Visited
from vision_pc.config.choices import PositioningMethod
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.orientation import OrientationResult
from vision_pc.core.positioning.corrected_positioning import CorrectedResult
from vision_pc.core.positioning.expected_end import ExpectedEnd
from vision_pc.core.positioning.look_then_move import ELSEWHERE, Ended, PositioningResult
from vision_pc.core.se3 import angle_between
from vision_pc.core.types import Look

JSON = dict[str, Any]
AROUND_NS = 250_000_000  # truth is averaged over a quarter of a second on either side of a look's time


class Rig(Protocol):
    """What the sequence drives: vision's REST API, or the same programs in lockstep.

    Every method raises LongreachError with the cause that the API would give.
    """

    def command(self, name: str) -> None:
        """Send a command of the REST API, such as ``enable``. Returns when it is accepted."""
        ...

    def operate(self, kind: str, body: JSON, bar: Bar) -> Any:
        """The typed result of a program, once it has succeeded."""
        ...

    def latest_look(self) -> Look:
        """The latest look of any program."""
        ...

    def picture(self) -> bytes:
        """The newest picture with detections, PNG."""
        ...

    def now_ns(self) -> int:
        """The time on vision's clock."""
        ...


class Clicked(NamedTuple):
    """A target without markers: where it was seen in C, (3,), when it was clicked on vision's clock."""

    time_ns: int
    p_C: Array


class Rest(NamedTuple):
    """The arm at rest at ``time_ns`` of vision's clock; ``look`` None where the look failed.

    ``clicked``: the target that was driven to; None: the object of interest.
    """

    label: str
    look_number: int
    time_ns: int
    look: Look | None
    note: str
    picture: Picture
    told: ExpectedEnd | None = None
    clicked: Clicked | None = None


class TimedTruth(NamedTuple):
    """What was true at ``time_ns`` of vision's clock."""

    time_ns: int
    truth: PlantTruth


class Recorder:
    """Gathers where the arm rested, step by step, so that a run that fails still shows how far it came."""

    def __init__(self, rig: Rig, bars: Bars) -> None:
        self.rests: list[Rest] = []
        self._rig = rig
        self._bars = bars

    def step(
        self, label: str, kind: str, body: JSON, *, look_number: int = 0, clicked: Clicked | None = None
    ) -> None:
        """Run the operation ``kind``, look, and note the result under ``label``."""
        with self._bars.step(label) as bar:
            result = self._rig.operate(kind, body, bar)
            looks_itself = kind in ("look", "look-then-move", "visit")
            look = self._rig.latest_look() if looks_itself else self._look(bar)
            time_ns = self._rig.now_ns() if look is None else look.time_ns
            picture = Picture(f"after: {label}", self._rig.picture())
            told = note_of(result), picture, told_of(result)
            self.rests.append(Rest(label, look_number, time_ns, look, *told, clicked))

    def _look(self, bar: Bar) -> Look | None:
        try:
            self._rig.operate("look", {}, bar)
        except MeasurementFailed:
            return None
        return self._rig.latest_look()


CALIBRATION = {
    PositioningMethod.CORRECTED: ("local track", "local-track"),
    PositioningMethod.PAPER: ("trajectory matching", "trajectory-matching"),
}
"""What each method calibrates by: its words, and the program."""


def demonstrate(
    rig: Rig,
    recorder: Recorder,
    looks: int,
    programs: Sequence[NamedRequest] = (),
    method: PositioningMethod = PositioningMethod.CORRECTED,
) -> None:
    """Run the whole sequence and note it in ``recorder``. Raises what stopped it.

    ``programs`` run in place of calibration and looks; the end of the last is what counts.
    """
    rig.command("enable")
    recorder.step("start", "look", {})
    recorder.step("orientation adjustment", "orientation-adjustment", {})
    names = [name for name, _ in programs]
    for index, (name, body) in enumerate(programs):
        label = f"{name} ({names[: index + 1].count(name)})" if names.count(name) > 1 else name
        recorder.step(label, name, dict(body), look_number=1 if index == len(programs) - 1 else 0)
    if programs:
        return
    recorder.step(*CALIBRATION[method], {})
    one: JSON = {"inputs": 1} if method is PositioningMethod.PAPER else {}
    for number in range(1, looks + 1):
        recorder.step(f"look {number}", "look-then-move", {"method": method} | one, look_number=number)


def told_of(result: Any) -> ExpectedEnd | None:
    """Where a program said, before it drove, that it would end."""
    if isinstance(result, tuple) and result and isinstance(result[-1], Visited):
        return told_of(result[-1].result)
    if isinstance(result, CorrectedResult):
        return told_of(result.positioning)
    if isinstance(result, PositioningResult) and result.steps:
        return result.steps[0].expected
    return None


def note_of(result: Any) -> str:
    """What a program's result says about its own quality, in words."""
    if isinstance(result, LocalCalibration):
        return (
            f"{result.samples} samples, rotation known to {math.degrees(result.rotation_std()):.2f}°, "
            f"residuals along the base's axes: mean {_mm(result.residuals.mean_m)} mm, greatest "
            f"{_mm(result.residuals.maximum_m)} mm"
        )
    if isinstance(result, tuple) and result and isinstance(result[-1], Visited):
        return note_of(result[-1].result)
    if isinstance(result, CorrectedResult):
        return note_of(result.positioning)
    if isinstance(result, PositioningResult):
        if not result.steps:
            return "already at the aim: no step was made"
        step, verdict = result.steps[0], result.final
        where = "inside" if verdict.inside else "outside"
        doubt = f"; CONTRADICTED{ELSEWHERE}" if result.ended is Ended.CONTRADICTED else ""
        return (
            f"step {_mm(step.p_lc)} mm in the base, expected to end within "
            f"{_mm(step.expected.std_m)} mm (1 σ, camera axes), inside with probability"
            f" {step.expected.inside:.2f}; found {where} the "
            f"tolerance, {'and so are' if verdict.certain else 'but not all of'} the 95 % intervals{doubt}"
        )
    if isinstance(result, OrientationResult):
        before, after = (_xyz(np.degrees(errors)) for errors in (result.errors[0], result.errors[-1]))
        return f"Euler angles {before}° before, {after}° after"
    return ""


def _mm(lengths_m: Array) -> str:
    return _xyz(1e3 * lengths_m)


def _xyz(values: Array) -> str:
    return "/".join(f"{value:.1f}" for value in values)


def stages(rests: Sequence[Rest], truths: Sequence[TimedTruth], clearance_m: float) -> tuple[Stage, ...]:
    """The rests with what was true then; times count from the first truth."""
    times_ns = np.array([truth.time_ns for truth in truths], dtype=np.int64)
    return tuple(
        Stage(
            rest.label,
            rest.look_number,
            1e-9 * (rest.time_ns - int(times_ns[0])),
            None if rest.look is None else _measured_errors(rest.look, clearance_m),
            _true(rest.time_ns, times_ns, truths, clearance_m),
            rest.note,
            rest.told,
        )
        for rest in rests
    )


def _measured_errors(look: Look, clearance_m: float) -> Errors:
    p = look.X_CO[:3, 3] - look.X_CM[:3, 3] - np.array([0.0, 0.0, clearance_m])
    return Errors(p, angle_between(look.X_CM[:3, :3], look.X_CO[:3, :3]))


def _true(
    time_ns: int, times_ns: NDArray[np.int64], truths: Sequence[TimedTruth], clearance_m: float
) -> Errors:
    """The mean of the truths around ``time_ns``; NaN, which passes no limit, where there are none."""
    around = [truths[int(i)].truth for i in np.flatnonzero(np.abs(times_ns - time_ns) <= AROUND_NS)]
    if not around:
        return Errors(np.full(3, np.nan), float("nan"))
    errors = np.array([tool_error(truth, clearance_m) for truth in around])
    angles = [angle_between(truth.R_CM, truth.R_CO) for truth in around]
    return Errors(errors.mean(axis=0), float(np.mean(angles)))


def traces(
    truths: Sequence[TimedTruth], views: Sequence[TracedView], clearance_m: float, arm: NominalArm
) -> Traces:
    """The run's curves; times count from the first truth."""
    begin_ns = truths[0].time_ns
    return Traces(
        true_time_s=np.array([1e-9 * (truth.time_ns - begin_ns) for truth in truths]),
        true_p_m=np.array([truth.truth.X_WT[:3, 3] for truth in truths]),
        true_error_m=np.array([tool_error(truth.truth, clearance_m) for truth in truths]),
        view_time_s=np.array([1e-9 * (view.time_ns - begin_ns) for view in views]),
        view_p_m=np.array([view.p_m for view in views]).reshape(-1, 3),
        q_cmd_rad=np.array([view.q_cmd_rad for view in views]).reshape(-1, 6),
        q_meas_rad=np.array([view.q_meas_rad for view in views]).reshape(-1, 6),
        links=dh_links(arm),
    )


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
            truth=_truth_about(
                timed.truth, next((p for end, p in goals if timed.time_ns <= end), goals[-1][1])
            )
        )
        for timed in truths
    ]


def _true_hole(clicked: Clicked, truths: Sequence[TimedTruth], holes_O: Array) -> Array:
    times = np.array([timed.time_ns for timed in truths], dtype=np.int64)
    truth = truths[int(np.abs(times - clicked.time_ns).argmin())].truth
    places = holes_O @ truth.R_CO.T + truth.p_CO
    return np.asarray(holes_O[int(np.linalg.norm(places - clicked.p_C, axis=1).argmin())])


def _truth_about(truth: PlantTruth, place_O: Array) -> PlantTruth:
    return truth._replace(p_CO=truth.p_CO + truth.R_CO @ place_O)
