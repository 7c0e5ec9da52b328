"""What a run of the demonstration produced: stages with image-based and true errors, and a verdict."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vision_pc.core.positioning.expected_end import ExpectedEnd

Array = NDArray[np.float64]

LIMIT_M = 0.005
"""What is wanted in x and y of the camera's axes (Mäkinen et al. 2023, section 5)."""


class Errors(NamedTuple):
    """An error of the tool at the object: ``p_m`` (3,) = p_CO - p_CM - [0, 0, clearance] in camera axes,
    ``angle_rad`` between object and tool marker."""

    p_m: Array
    angle_rad: float

    def within(self, limit_m: float) -> bool:
        """Whether x and y are both inside ``limit_m``."""
        return bool(np.all(np.abs(self.p_m[:2]) <= limit_m))


class Stage(NamedTuple):
    """The arm at rest after one step.

    ``look`` counts look-then-moves (0: another step). ``image`` is what a look measured there, None where it
    failed; ``true`` is the plant's own truth at the same time; ``note`` what the step itself reported;
    ``told`` where its drive was expected to end, if that was told before.
    """

    label: str
    look: int
    time_s: float
    image: Errors | None
    true: Errors
    note: str = ""
    told: ExpectedEnd | None = None


class Outcome(NamedTuple):
    """One run of which ``looks`` look-then-moves were wanted; ``stages`` as far as it came.

    ``every``: each of them had a goal of its own, and counts.
    """

    mode: str
    scenario: str
    seed: int
    looks: int
    stages: tuple[Stage, ...]
    wall_s: float
    simulated_s: float
    details: Mapping[str, Any]
    every: bool = False

    def after_look(self, number: int) -> Stage | None:
        """The stage after look ``number`` (1, 2, …), None when the run did not get there."""
        return next((stage for stage in self.stages if stage.look == number), None)

    @property
    def passed(self) -> bool:
        """Whether the true error in x and y is inside the limit after the last look, or after every one."""
        numbers = range(1, self.looks + 1) if self.every else (self.looks,)
        ends = [self.after_look(number) for number in numbers]
        return all(end is not None and end.true.within(LIMIT_M) for end in ends)


def verdict(outcome: Outcome) -> str:
    """The verdict as one sentence."""
    last = outcome.after_look(outcome.looks)
    if last is None:
        reached = outcome.stages[-1].label if outcome.stages else "nothing"
        return f"look {outcome.looks} was not reached; the last stage was: {reached}"
    word = "within" if outcome.passed else "NOT within"
    if outcome.every:
        ends = [stage for stage in outcome.stages if stage.look]
        errors = [f"{1e3 * end.true.p_m[0]:+.2f}/{1e3 * end.true.p_m[1]:+.2f}" for end in ends]
        where = f"true errors x/y at {len(ends)} targets, mm: {', '.join(errors)}"
        return f"{where}; {word} ±{1e3 * LIMIT_M:.0f} mm"
    x, y, z = 1e3 * last.true.p_m
    return (
        f"true error after {last.label}: x {x:+.2f} mm, y {y:+.2f} mm (z {z:+.2f} mm), "
        f"{word} ±{1e3 * LIMIT_M:.0f} mm in x and y"
    )


HEADINGS = (
    "after",
    "image x",
    "image y",
    "image z",
    "image angle",
    "true x",
    "true y",
    "true z",
    "true angle",
)


def rows(stages: Sequence[Stage]) -> list[tuple[str, ...]]:
    """One row of text for each stage, under ``HEADINGS``: mm and degrees; a failed look is a dash."""
    return [(stage.label, *_cells(stage.image), *_cells(stage.true)) for stage in stages]


def _cells(errors: Errors | None) -> tuple[str, ...]:
    if errors is None:
        return ("–",) * 4
    return (*(f"{1e3 * value:+.2f}" for value in errors.p_m), f"{np.degrees(errors.angle_rad):.2f}")


def _figures(errors: Errors | None) -> dict[str, float] | None:
    if errors is None:
        return None
    x, y, z = (1e3 * float(value) for value in errors.p_m)
    return {"x_mm": x, "y_mm": y, "z_mm": z, "angle_deg": float(np.degrees(errors.angle_rad))}


def figures(outcome: Outcome) -> dict[str, Any]:
    """All that is printed about ``outcome``, for a JSON file."""
    return {
        "mode": outcome.mode,
        "scenario": outcome.scenario,
        "seed": outcome.seed,
        "looks": outcome.looks,
        "limit_mm": 1e3 * LIMIT_M,
        "passed": outcome.passed,
        "verdict": verdict(outcome),
        "wall_s": outcome.wall_s,
        "simulated_s": outcome.simulated_s,
        "stages": [
            {
                "label": stage.label,
                "time_s": stage.time_s,
                "image": _figures(stage.image),
                "true": _figures(stage.true),
                "note": stage.note,
            }
            for stage in outcome.stages
        ],
        **outcome.details,
    }
