"""Hua et al. 2024, Fig. 7: error of X against the noise level d, every method and the Cramér-Rao bound.

Level d means 0.01 d degrees and 0.02 d millimetres a component. ``NoiseOn`` says what is noisy: the paper
writes "the camera motion"; absolute poses of camera or robot are what a real session has.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from laboratory.experiments.hand_eye import scenes
from laboratory.experiments.hand_eye.scenes import HandEyeScene
from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.se3 import Array

ROTATION_DEG, TRANSLATION_MM = 0.01, 0.02
MOTION_METHODS = (
    Method.TSAI,
    Method.PARK,
    Method.HORAUD,
    Method.DANIILIDIS,
    Method.DQCR,
    Method.MAXIMUM_LIKELIHOOD,
)


class NoiseOn(StrEnum):
    """What is noisy."""

    CAMERA_POSES = "camera-poses"
    ROBOT_POSES = "robot-poses"
    CAMERA_MOTIONS = "camera-motions"


class SweepRow(NamedTuple):
    """One method at one noise level: root-mean-square errors; ``failed`` runs raised an error.

    ``nees`` is the mean normalised squared error by the method's own covariance (6 when honest);
    ``least_eigenvalue`` the worst certificate; ``dropped`` the good samples it left out, over all runs.
    """

    noise_on: str
    level: int
    method: str
    rotation_deg: float
    translation_mm: float
    bound_rotation_deg: float
    bound_translation_mm: float
    runs: int
    failed: int
    nees: float | None = None
    least_eigenvalue: float | None = None
    dropped: int | None = None

    @property
    def rotation_over_bound(self) -> float:
        """1 is as good as an unbiased estimator can be."""
        return self.rotation_deg / self.bound_rotation_deg

    @property
    def translation_over_bound(self) -> float:
        """1 is as good as an unbiased estimator can be."""
        return self.translation_mm / self.bound_translation_mm


@dataclass
class _SweepCounts:
    """Errors (6,) of one method over the runs of a level, and what else was told of them."""

    errors: list[Array] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    eigenvalues: list[float] = field(default_factory=list)
    failed: int = 0
    dropped: int = 0

    def enter(self, result: HandEyeResult, truth: Array) -> None:
        """Count one result beside the true X (4, 4)."""
        error = se3.local(result.X, truth)
        self.errors.append(error)
        if result.certificate is not None:
            self.eigenvalues.append(result.certificate.least_eigenvalue)
        if result.covariance is not None:
            self.nees.append(float(error @ np.linalg.solve(result.covariance, error)))
            self.dropped += int((~result.inliers).sum())

    def row(self, noise_on: NoiseOn, level: int, method: str, bound: scenes.Bound) -> SweepRow:
        E = np.array(self.errors).reshape(-1, 6)
        rms = (
            np.sqrt(np.mean(np.sum(E.reshape(-1, 2, 3) ** 2, axis=-1), axis=0)) if len(E) else [math.nan] * 2
        )
        return SweepRow(
            noise_on.value,
            level,
            method,
            math.degrees(rms[1]),
            1e3 * float(rms[0]),
            bound.rotation_deg,
            bound.translation_mm,
            len(E) + self.failed,
            self.failed,
            float(np.mean(self.nees)) if self.nees else None,
            min(self.eigenvalues) if self.eigenvalues else None,
            self.dropped if self.nees else None,
        )


def noise_sweep(
    noise_on: NoiseOn = NoiseOn.CAMERA_POSES,
    runs: int = 200,
    levels: Iterable[int] = range(1, 11),
    seed: int = 1,
    only: Iterable[Method] | None = None,
) -> list[SweepRow]:
    """Errors of every method, or ``only`` some, at each level over ``runs`` seeded runs."""
    scene = scenes.table_1_scene()
    chosen = tuple(only) if only is not None else tuple(Method)
    rows: list[SweepRow] = []
    for level in levels:
        n = scenes.noise(ROTATION_DEG * level, TRANSLATION_MM * level, noise_on is NoiseOn.ROBOT_POSES)
        bound = scenes.bound(scene, n, noise_on is NoiseOn.CAMERA_MOTIONS)
        counts: dict[Method, _SweepCounts] = {}
        for run in range(runs):
            rng = np.random.default_rng([seed, level, run])
            _enter_run(scene, n, rng, chosen, counts, noise_on is NoiseOn.CAMERA_MOTIONS)
        rows += [count.row(noise_on, level, method.value, bound) for method, count in counts.items()]
    return rows


def level_of(task: dict[str, Any]) -> dict[str, Any]:
    """One level as the run of a campaign."""
    return {"rows": noise_sweep(NoiseOn(task["noise_on"]), task["runs"], [task["level"]], task["seed"])}


def _enter_run(
    scene: HandEyeScene,
    n: Any,
    rng: np.random.Generator,
    chosen: tuple[Method, ...],
    counts: dict[Method, _SweepCounts],
    by_motions: bool,
) -> None:
    """Enter into ``counts`` what the methods make of one noisy data set: of its poses, or its motions."""
    motions = scenes.measured_motions(scene, n, rng) if by_motions else None
    pairs = None if by_motions else scenes.measured(scene, n, rng)
    for method in MOTION_METHODS if by_motions else chosen:
        if method not in chosen:
            continue
        count = counts.setdefault(method, _SweepCounts())
        try:
            if motions is not None:
                count.errors.append(se3.local(methods.solve_motions(motions, method), scene.X))
            elif pairs is not None:
                count.enter(methods.solve(pairs, method), scene.X)
        except MeasurementFailed:
            count.failed += 1
