"""Hua et al. 2024, Fig. 7: error of X against the noise level d, every method and the Cramér-Rao bound.

Level d means 0.01 d degrees and 0.02 d millimetres a component of the camera's absolute poses, as a real
session has them; the paper writes "the camera motion".
"""

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from laboratory.experiments.hand_eye import scenes
from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.se3 import Array

ROTATION_DEG, TRANSLATION_MM = 0.01, 0.02


class SweepRow(NamedTuple):
    """One method at one noise level: root-mean-square errors; ``failed`` runs gave no proper pose.

    ``…_over_bound``: 1 is as good as an unbiased estimator can be. ``nees`` is the mean normalised squared
    error by the method's own covariance (6 when honest); ``least_eigenvalue`` the worst certificate.
    """

    level: int
    method: str
    rotation_deg: float
    translation_mm: float
    bound_rotation_deg: float
    bound_translation_mm: float
    rotation_over_bound: float
    translation_over_bound: float
    failed: int
    nees: float | None = None
    least_eigenvalue: float | None = None


class SolverAttempt(NamedTuple):
    """One method in one run: its error (6,) of X, None where it refused or gave no proper pose.

    ``improper``: NaN or a left-handed rotation; ``bad_found``: of the bad samples, how many were left out.
    """

    method: str
    error: list[float] | None = None
    improper: bool = False
    bad_found: int = 0
    nees: float | None = None
    eigenvalue: float | None = None


def attempt(pairs: PosePairs, method: Method, truth: Array, bad: Collection[str] = ()) -> SolverAttempt:
    """The method on those samples, the ``bad`` ones by name."""
    try:
        result = methods.solve(pairs, method)
    except MeasurementFailed:
        return SolverAttempt(method.value)
    R, covariance, certificate = result.X[:3, :3], result.covariance, result.certificate
    orthonormal = np.isfinite(result.X).all() and np.abs(R.T @ R - np.eye(3)).max() <= 1e-9
    if not orthonormal or np.linalg.det(R) < 0.999:
        return SolverAttempt(result.method, improper=True)
    dropped = {name for name, inlier in zip(result.names, result.inliers, strict=True) if not inlier}
    error = se3.local(result.X, truth)
    nees = None if covariance is None else float(error @ np.linalg.solve(covariance, error))
    found = len(dropped.intersection(bad))
    least = None if certificate is None else certificate.least_eigenvalue
    return SolverAttempt(result.method, error.tolist(), False, found, nees, least)


def sizes(attempts: Sequence[SolverAttempt]) -> tuple[Array, Array]:
    """Errors of those that ended: millimetres (n,) and degrees (n,); NaN where none did."""
    errors = np.array([one.error for one in attempts if one.error is not None]).reshape(-1, 2, 3)
    lengths = np.linalg.norm(errors, axis=-1) if len(errors) else np.full((1, 2), np.nan)
    return 1e3 * lengths[:, 0], np.degrees(lengths[:, 1])


def level_of(_config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """One level as the run of a campaign."""
    return {"rows": noise_level(task["runs"], task["level"], task["seed"])}


def noise_level(runs: int, level: int, seed: int, chosen: Iterable[Method] = tuple(Method)) -> list[SweepRow]:
    """Errors of the ``chosen`` methods at one level over ``runs`` seeded runs."""
    scene, n = scenes.table_1_scene(), scenes.noise(ROTATION_DEG * level, TRANSLATION_MM * level)
    attempts: dict[Method, list[SolverAttempt]] = {method: [] for method in chosen}
    for run in range(runs):
        pairs = scenes.measured(scene, n, np.random.default_rng([seed, level, run]))
        for method, made in attempts.items():
            made.append(attempt(pairs, method, scene.X))
    bound = scenes.bound(scene, n)
    return [_row(level, method, made, bound) for method, made in attempts.items()]


def _row(level: int, method: Method, attempts: list[SolverAttempt], bound: scenes.Bound) -> SweepRow:
    translation_mm, rotation_deg = (float(np.sqrt(np.mean(size**2))) for size in sizes(attempts))
    nees = [one.nees for one in attempts if one.nees is not None]
    return SweepRow(
        level,
        method.value,
        rotation_deg,
        translation_mm,
        *bound,
        rotation_deg / bound.rotation_deg,
        translation_mm / bound.translation_mm,
        sum(one.error is None for one in attempts),
        float(np.mean(nees)) if nees else None,
        min((one.eigenvalue for one in attempts if one.eigenvalue is not None), default=None),
    )
