"""Where hand-eye calibrations break: bad samples among the good, and booms that hardly turn."""

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from protocol.errors import LongreachError, MeasurementFailed
from testbed.hand_eye import scenes
from testbed.hand_eye.scenes import Scene
from vision_pc.core import se3
from vision_pc.core.hand_eye import methods
from vision_pc.core.hand_eye.methods import Method
from vision_pc.core.hand_eye.result import HandEyeResult
from vision_pc.core.se3 import Array

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class StressRow:
    """One method over all runs: median, root-mean-square and 95 % quantile of the error of X.

    ``refused`` runs raised an error; ``improper`` gave NaN or a left-handed rotation (must be 0); ``found``
    is the share of bad samples that were flagged, ``wrongly_dropped`` of good ones; ``uncertified`` runs
    had no proof.
    """

    scenario: str
    method: str
    runs: int
    rotation_median_deg: float
    rotation_rms_deg: float
    rotation_95_deg: float
    translation_median_mm: float
    translation_rms_mm: float
    translation_95_mm: float
    bound_rotation_deg: float
    bound_translation_mm: float
    refused: int
    improper: int
    found: float | None = None
    wrongly_dropped: float | None = None
    uncertified: int | None = None

    def as_json(self) -> dict[str, Any]:
        """For ``--json``."""
        return asdict(self)


class _Tally:
    def __init__(self) -> None:
        self.errors: list[Array] = []
        self.refused = self.improper = self.uncertified = 0
        self.flagged_bad = self.flagged_good = 0
        self.selects = self.certifies = False

    def enter(self, result: HandEyeResult, truth: Array, bad: set[str]) -> None:
        R = result.X[:3, :3]
        if (
            not np.isfinite(result.X).all()
            or np.linalg.det(R) < 0.999
            or np.abs(R.T @ R - np.eye(3)).max() > 1e-9
        ):
            self.improper += 1
            return
        self.errors.append(se3.local(result.X, truth))
        if result.method == Method.ROBUST:
            self.selects = True
            dropped = {name for name, inlier in zip(result.names, result.inliers, strict=True) if not inlier}
            self.flagged_bad += len(dropped & bad)
            self.flagged_good += len(dropped - bad)
        if result.certificate is not None:
            self.certifies = True
            self.uncertified += not result.certificate.holds

    def row(self, scenario: str, method: str, bound: scenes.Bound, bad: int, good: int) -> StressRow:
        E = np.array(self.errors).reshape(-1, 2, 3)
        sizes = np.linalg.norm(E, axis=-1) if len(E) else np.full((1, 2), math.nan)
        shift, turn = 1e3 * sizes[:, 0], np.degrees(sizes[:, 1])
        runs = len(self.errors)
        return StressRow(
            scenario,
            method,
            runs + self.refused + self.improper,
            float(np.median(turn)),
            float(np.sqrt(np.mean(turn**2))),
            float(np.quantile(turn, 0.95)),
            float(np.median(shift)),
            float(np.sqrt(np.mean(shift**2))),
            float(np.quantile(shift, 0.95)),
            bound.rotation_deg,
            bound.translation_mm,
            self.refused,
            self.improper,
            self.flagged_bad / (bad * runs) if self.selects and bad else None,
            self.flagged_good / (good * runs) if self.selects and runs else None,
            self.uncertified if self.certifies else None,
        )


def outliers(
    runs: int = 200,
    samples: int = 15,
    bad: int = 2,
    rotation_deg: float = 0.1,
    translation_mm: float = 1.0,
    seed: int = 1,
    only: Iterable[Method] | None = None,
    progress: Progress | None = None,
) -> tuple[StressRow, ...]:
    """Every method with ``bad`` of ``samples`` grossly wrong; the bound is that of the good samples alone."""

    def scene(rng: np.random.Generator) -> Scene:
        return scenes.viewing_scene(rng, samples)

    return _stress(
        f"{bad} of {samples} bad", scene, bad, rotation_deg, translation_mm, runs, seed, only, progress
    )


def small_rotations(
    runs: int = 200,
    samples: int = 20,
    largest_deg: float = 5.0,
    rotation_deg: float = 0.05,
    translation_mm: float = 0.5,
    seed: int = 1,
    only: Iterable[Method] | None = None,
    progress: Progress | None = None,
) -> tuple[StressRow, ...]:
    """Every method where no two poses differ by more than ``largest_deg``, target 1 m before the camera."""

    def scene(rng: np.random.Generator) -> Scene:
        return scenes.small_rotation_scene(rng, samples, largest_deg)

    name = f"rotations under {largest_deg:g} deg"
    return _stress(name, scene, 0, rotation_deg, translation_mm, runs, seed, only, progress)


def _stress(
    scenario: str,
    make: Callable[[np.random.Generator], Scene],
    bad: int,
    rotation_deg: float,
    translation_mm: float,
    runs: int,
    seed: int,
    only: Iterable[Method] | None,
    progress: Progress | None,
) -> tuple[StressRow, ...]:
    n = scenes.noise(rotation_deg, translation_mm)
    chosen = tuple(only) if only is not None else tuple(Method)
    tallies = {method: _Tally() for method in chosen}
    bounds: list[scenes.Bound] = []
    count = 0
    for run in range(runs):
        rng = np.random.default_rng([seed, run])
        scene = make(rng)
        count = len(scene.X_BH)
        pairs, spoiled = scenes.measured_with_bad(scene, n, rng, bad)
        good = np.array([k for k in range(count) if str(k + 1) not in spoiled])
        bounds.append(scenes.bound(scene._replace(X_BH=scene.X_BH[good]), n))
        for method, tally in tallies.items():
            try:
                tally.enter(methods.solve(pairs, method), scene.X, spoiled)
            except MeasurementFailed:
                tally.refused += 1
        if progress is not None:
            progress((run + 1) / runs, scenario)
    if not bounds:
        raise LongreachError("refused.runs", "at least one run is needed")
    squares = np.mean(np.square(np.array(bounds)), axis=0)
    bound = scenes.Bound(float(np.sqrt(squares[0])), float(np.sqrt(squares[1])))
    return tuple(tally.row(scenario, m.value, bound, bad, count - bad) for m, tally in tallies.items())
