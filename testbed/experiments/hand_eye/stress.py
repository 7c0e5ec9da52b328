"""Where hand-eye calibrations break: bad samples among the good, and booms that hardly turn."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from protocol.errors import LongreachError, MeasurementFailed
from testbed.experiments.hand_eye import scenes
from testbed.experiments.hand_eye.scenes import HandEyeScene
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.se3 import Array

_FLAGS = ("selects", "certifies")
# DQCR in closed form stands for DQCR as published, which takes fifty times as long for the same (hua-fig7).
METHODS = tuple(method for method in Method if method is not Method.DQCR_PUBLISHED)


class StressRow(NamedTuple):
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


@dataclass
class _StressCounts:
    """One method over some runs; ``errors`` (6,) each."""

    errors: list[Any] = field(default_factory=list)
    refused: int = 0
    improper: int = 0
    uncertified: int = 0
    flagged_bad: int = 0
    flagged_good: int = 0
    selects: bool = False
    certifies: bool = False

    def add(self, other: "_StressCounts") -> None:
        """The other's runs too."""
        for name, value in vars(other).items():
            mine = getattr(self, name)
            setattr(self, name, (mine or value) if name in _FLAGS else mine + value)

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


class StressTrial(NamedTuple):
    """One way to break calibrations: noise, how many samples and bad ones, how little the hand turns."""

    name: str
    samples: int
    bad: int
    rotation_deg: float
    translation_mm: float
    largest_deg: float | None = None  # None: views from all sides

    def scene(self, rng: np.random.Generator) -> HandEyeScene:
        """A scene drawn for it."""
        if self.largest_deg is None:
            return scenes.viewing_scene(rng, self.samples)
        return scenes.small_rotation_scene(rng, self.samples, self.largest_deg)


BAD_SAMPLES = StressTrial("2 of 15 bad", 15, 2, 0.1, 1.0)
SMALL_ROTATIONS = StressTrial("rotations under 5 deg", 20, 0, 0.05, 0.5, 5.0)
TRIALS = {trial.name: trial for trial in (BAD_SAMPLES, SMALL_ROTATIONS)}


class Block(NamedTuple):
    """Some runs of a trial: tallies by method, and the Cramér-Rao bound of each run (deg, mm)."""

    tallies: dict[str, _StressCounts]
    bounds: list[Any]


def outliers(runs: int = 200, seed: int = 1, only: Iterable[Method] | None = None) -> tuple[StressRow, ...]:
    """Every method with 2 of 15 samples grossly wrong; the bound is that of the good samples alone."""
    return _rows(BAD_SAMPLES, [_block(BAD_SAMPLES, range(runs), seed, _chosen(only))])


def small_rotations(
    runs: int = 200, seed: int = 1, only: Iterable[Method] | None = None
) -> tuple[StressRow, ...]:
    """Every method where no two poses differ by more than 5°, target 1 m before the camera."""
    return _rows(SMALL_ROTATIONS, [_block(SMALL_ROTATIONS, range(runs), seed, _chosen(only))])


def block_row(task: dict[str, Any]) -> dict[str, Any]:
    """A campaign's row: ``count`` runs of the trial ``trial`` from ``first`` on."""
    runs = range(int(task["first"]), int(task["first"]) + int(task["count"]))
    block = _block(TRIALS[task["trial"]], runs, int(task["seed"]), METHODS)
    tallies = {name: vars(tally) for name, tally in block.tallies.items()}
    return {"trial": task["trial"], "tallies": tallies, "bounds": block.bounds}


def rows_of(trial: StressTrial, rows: Iterable[dict[str, Any]]) -> tuple[StressRow, ...]:
    """What the rows of ``block_row`` for ``trial`` amount to."""
    blocks = [
        Block({name: _StressCounts(**kept) for name, kept in row["tallies"].items()}, row["bounds"])
        for row in rows
        if row["trial"] == trial.name
    ]
    return _rows(trial, blocks)


def _chosen(only: Iterable[Method] | None) -> tuple[Method, ...]:
    return tuple(only) if only is not None else METHODS


def _block(trial: StressTrial, runs: range, seed: int, chosen: tuple[Method, ...]) -> Block:
    n = scenes.noise(trial.rotation_deg, trial.translation_mm)
    tallies = {method.value: _StressCounts() for method in chosen}
    bounds = []
    for run in runs:
        rng = np.random.default_rng([seed, run])
        scene = trial.scene(rng)
        pairs, spoiled = scenes.measured_with_bad(scene, n, rng, trial.bad)
        good = np.array([k for k in range(trial.samples) if str(k + 1) not in spoiled])
        bounds.append(tuple(scenes.bound(scene._replace(X_BT=scene.X_BT[good]), n)))
        for method in chosen:
            try:
                tallies[method.value].enter(methods.solve(pairs, method), scene.X, spoiled)
            except MeasurementFailed:
                tallies[method.value].refused += 1
    return Block(tallies, bounds)


def _rows(trial: StressTrial, blocks: list[Block]) -> tuple[StressRow, ...]:
    bounds = [bound for block in blocks for bound in block.bounds]
    if not bounds:
        raise LongreachError("refused.runs", "at least one run is needed")
    bound = scenes.Bound(*(float(v) for v in np.sqrt(np.mean(np.square(np.array(bounds)), axis=0))))
    tallies: dict[str, _StressCounts] = {}
    for block in blocks:
        for name, tally in block.tallies.items():
            tallies.setdefault(name, _StressCounts()).add(tally)
    good = trial.samples - trial.bad
    return tuple(tally.row(trial.name, name, bound, trial.bad, good) for name, tally in tallies.items())
