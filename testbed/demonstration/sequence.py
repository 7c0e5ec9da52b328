"""The demonstration as a sequence of operations, the same over the REST API and in lockstep.

Orientation adjustment, local calibration, then look-then-moves, with a look wherever the arm comes to rest.
What was true at those times is found out afterwards, from the plant's own recording.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from plant_emulator.core.truth import PlantTruth, tool_error
from protocol.errors import MeasurementFailed
from testbed.reporting.console import Bar, Bars
from testbed.reporting.outcome import Errors, Stage
from testbed.reporting.plots import ErrorTrace
from testbed.reporting.report import Picture
from testbed.scenarios.scenario import NamedRequest
from vision_pc.application.results import JSON
from vision_pc.config.choices import PositioningMethod
from vision_pc.core.se3 import angle_between
from vision_pc.core.types import Look

AROUND_NS = 250_000_000  # truth is averaged over a quarter of a second on either side of a look's time


class Rig(Protocol):
    """What the sequence drives: vision's REST API, or the same programs in lockstep.

    Every method raises LongreachError with the cause that the API would give.
    """

    def command(self, name: str) -> None:
        """Send a command of the REST API, such as ``enable``. Returns when it is accepted."""
        ...

    def result(self, kind: str, body: JSON, bar: Bar) -> JSON:
        """The result of a program as the API gives it, once it has succeeded."""
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


class Rest(NamedTuple):
    """The arm at rest at ``time_ns`` of vision's clock; ``look`` None where the look failed."""

    label: str
    look_number: int
    time_ns: int
    look: Look | None
    note: str
    picture: Picture
    predicted: JSON | None = None


TimedTruths = Sequence[tuple[int, PlantTruth]]
"""What was true, and when by vision's clock (ns)."""


class Recorder:
    """Gathers where the arm rested, step by step, so that a run that fails still shows how far it came."""

    def __init__(self, rig: Rig, bars: Bars) -> None:
        self.rests: list[Rest] = []
        self.bars, self.rig = bars, rig

    def step(self, label: str, kind: str, body: JSON, look_number: int = 0) -> None:
        """Run the operation ``kind``, look, and note the result under ``label``."""
        with self.bars.step(label) as bar:
            result = self.rig.result(kind, body, bar)
            look = self.rig.latest_look() if kind in ("look", "look-then-move") else self._look(bar)
            time_ns = self.rig.now_ns() if look is None else look.time_ns
            picture = Picture(f"after: {label}", self.rig.picture())
            steps = result["steps"] if kind == "look-then-move" else ()
            predicted = steps[0]["expected"] if steps else None
            self.rests.append(Rest(label, look_number, time_ns, look, note_of(result), picture, predicted))

    def _look(self, bar: Bar) -> Look | None:
        try:
            self.rig.result("look", {}, bar)
        except MeasurementFailed:
            return None
        return self.rig.latest_look()


CALIBRATION = {
    PositioningMethod.CORRECTED: ("local track", "local-track"),
    PositioningMethod.PAPER: ("trajectory matching", "trajectory-matching"),
}
"""What each method calibrates by: its words, and the program."""


def demonstrate(
    recorder: Recorder,
    looks: int,
    programs: Sequence[NamedRequest] = (),
    method: PositioningMethod = PositioningMethod.CORRECTED,
) -> None:
    """Run the whole sequence and note it in ``recorder``. Raises what stopped it.

    ``programs`` run in place of calibration and looks; the end of the last is what counts.
    """
    recorder.rig.command("enable")
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


def note_of(result: JSON) -> str:
    """What a program's result says about its own quality, in words."""
    if "residual_mean_mm" in result:
        return (
            f"{result['samples']} samples, rotation known to {result['rotation_std_deg']:.2f}°, residuals"
            f" along the base's axes: mean {_xyz(result['residual_mean_mm'])} mm, greatest"
            f" {_xyz(result['residual_max_mm'])} mm"
        )
    if "errors_deg" in result:
        return f"Euler angles {_xyz(result['before_deg'])}° before, {_xyz(result['after_deg'])}° after"
    if "contradiction" not in result:
        return ""
    if not result["steps"]:
        return "already at the aim: no step was made"
    step, doubt = result["steps"][0], result["contradiction"]
    expected = step["expected"]
    return (
        f"step {_xyz(step['p_lc_mm'])} mm in the base, expected to end within {_xyz(expected['std_mm'])} mm"
        f" (1 σ, camera axes), inside with probability {expected['inside_probability']:.2f}; found"
        f" {result['verdict']} the tolerance,"
        f" {'and so are' if result['certain'] else 'but not all of'} the 95 % intervals"
        + (f"; CONTRADICTED; {doubt['detail']}" if doubt else "")
    )


def _xyz(values: JSON) -> str:
    return "/".join(f"{values[axis]:.1f}" for axis in "xyz")


def stages(rests: Sequence[Rest], truths: TimedTruths, clearance_m: float) -> tuple[Stage, ...]:
    """The rests with what was true then; times count from the first truth."""
    times_ns = np.array([time_ns for time_ns, _ in truths], dtype=np.int64)
    errors = np.array([tool_error(truth, clearance_m) for _, truth in truths])
    angles = np.array([angle_between(truth.R_CM, truth.R_CO) for _, truth in truths])

    def true(time_ns: int) -> Errors:
        """The mean around ``time_ns``; NaN, which passes no limit, where there is nothing."""
        around = np.abs(times_ns - time_ns) <= AROUND_NS
        if not around.any():
            return Errors(np.full(3, np.nan), float("nan"))
        return Errors(errors[around].mean(axis=0), float(angles[around].mean()))

    return tuple(
        Stage(
            rest.label,
            rest.look_number,
            1e-9 * (rest.time_ns - int(times_ns[0])),
            None if rest.look is None else _measured_errors(rest.look, clearance_m),
            true(rest.time_ns),
            rest.note,
            rest.predicted,
        )
        for rest in rests
    )


def _measured_errors(look: Look, clearance_m: float) -> Errors:
    p = look.X_CO[:3, 3] - look.X_CM[:3, 3] - np.array([0.0, 0.0, clearance_m])
    return Errors(p, angle_between(look.X_CM[:3, :3], look.X_CO[:3, :3]))


def error_trace(truths: TimedTruths, clearance_m: float) -> ErrorTrace:
    """The true error over the run; times count from the first truth."""
    return ErrorTrace(
        time_s=np.array([1e-9 * (time_ns - truths[0][0]) for time_ns, _ in truths]),
        error_m=np.array([tool_error(truth, clearance_m) for _, truth in truths]),
    )
