"""What a run of the demonstration produced: stages with image-based and true errors, and a verdict."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIMIT_M = 0.005
"""What is wanted in x and y of the camera's axes (Mäkinen et al. 2023, section 5)."""


class Errors(NamedTuple):
    """An error of the tool at the object: ``p_m`` (3,) = p_CO - p_CM - [0, 0, clearance] in camera axes,
    ``angle_rad`` between object and tool marker."""

    p_m: Array
    angle_rad: float

    @property
    def values(self) -> tuple[float, ...]:
        """x, y, z in mm and the angle in degrees."""
        return (*(1e3 * self.p_m).tolist(), float(np.degrees(self.angle_rad)))


class Stage(NamedTuple):
    """The arm at rest after one step.

    ``look`` counts look-then-moves (0: another step). ``image`` is what a look measured there, None where it
    failed; ``true`` is the plant's own truth at the same time; ``note`` what the step itself reported;
    ``predicted`` where its drive was expected to end, as the REST API has it, if that was predicted.
    """

    label: str
    look: int
    time_s: float
    image: Errors | None
    true: Errors
    note: str = ""
    predicted: Mapping[str, Any] | None = None


class Outcome(NamedTuple):
    """One run of which ``looks`` look-then-moves were wanted; ``stages`` as far as it came."""

    mode: str
    scenario: str
    seed: int
    looks: int
    stages: tuple[Stage, ...]
    wall_s: float
    simulated_s: float
    details: Mapping[str, Any]

    def after_look(self, number: int) -> Stage | None:
        """The stage after look ``number`` (1, 2, …), None when the run did not get there."""
        return next((stage for stage in self.stages if stage.look == number), None)

    @property
    def passed(self) -> bool:
        """Whether the true error in x and y is inside the limit after the last look."""
        last = self.after_look(self.looks)
        return last is not None and bool(np.all(np.abs(last.true.p_m[:2]) <= LIMIT_M))

    @property
    def verdict(self) -> str:
        """The verdict as one sentence."""
        last = self.after_look(self.looks)
        if last is None:
            reached = self.stages[-1].label if self.stages else "nothing"
            return f"look {self.looks} was not reached; the last stage was: {reached}"
        limit = f"{'within' if self.passed else 'NOT within'} ±{1e3 * LIMIT_M:.0f} mm"
        x, y, z, _ = last.true.values
        return (
            f"true error after {last.label}: x {x:+.2f} mm, y {y:+.2f} mm (z {z:+.2f} mm), {limit} in x and y"
        )


HEADINGS = ("after", *(f"{whose} {what}" for whose in ("image", "true") for what in ("x", "y", "z", "angle")))


def rows(stages: Sequence[Stage]) -> list[tuple[str, ...]]:
    """One row of text for each stage, under ``HEADINGS``: mm and degrees; a failed look is a dash."""
    return [(stage.label, *_cells(stage.image), *_cells(stage.true)) for stage in stages]


def _cells(errors: Errors | None) -> tuple[str, ...]:
    if errors is None:
        return ("–",) * 4
    *lengths, angle = errors.values
    return (*(f"{value:+.2f}" for value in lengths), f"{angle:.2f}")


def results(outcome: Outcome) -> dict[str, Any]:
    """All that is printed about ``outcome``, for a JSON file."""
    names = ("x_mm", "y_mm", "z_mm", "angle_deg")
    known = outcome._asdict()
    stages = [
        {"label": stage.label, "time_s": stage.time_s, "note": stage.note}
        | {"image": stage.image and dict(zip(names, stage.image.values, strict=True))}
        | {"true": dict(zip(names, stage.true.values, strict=True))}
        for stage in outcome.stages
    ]
    numbers = {key: known[key] for key in ("mode", "scenario", "seed", "looks", "wall_s", "simulated_s")}
    judged = {"limit_mm": 1e3 * LIMIT_M, "passed": outcome.passed, "verdict": outcome.verdict}
    return numbers | judged | {"stages": stages} | dict(outcome.details)
