"""`longreach experiment hua --method stress`: bad samples among the good, booms that hardly turn."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Check, Experiment, Finished, NoSettings, at_most
from laboratory.campaigns.workforce import Task
from laboratory.experiments.hand_eye import scenes
from laboratory.experiments.hand_eye.hua import demand_all
from laboratory.experiments.hand_eye.scenes import HandEyeScene
from protocol.errors import MeasurementFailed
from testbed.reporting.console import Columns, listed
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.se3 import Array

_ENOUGH = 100  # runs: with fewer, chance decides
_BLOCK = 25  # runs of a row


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


class SolverAttempt(NamedTuple):
    """One method in one run: its error (6,) of X, None where it refused or gave no proper pose.

    ``improper``: NaN or a left-handed rotation; ``bad_found``, ``good_lost``: samples that were left out;
    ``proven``: None where the method has no proof.
    """

    method: str
    error: list[float] | None = None
    improper: bool = False
    bad_found: int = 0
    good_lost: int = 0
    proven: bool | None = None


class StressBlock(NamedTuple):
    """A campaign's row: the attempts of some runs of a trial, and each run's Cramér-Rao bound (deg, mm)."""

    trial: str
    attempts: list[Any] | None
    bounds: list[Any] | None
    failure: str
    cpu_s: float


class StressRow(NamedTuple):
    """One method over all runs of a trial."""

    method: str
    runs: int
    rotation_median_deg: float
    rotation_rms_deg: float
    translation_median_mm: float
    translation_rms_mm: float
    translation_95_mm: float
    bound_translation_mm: float
    refused: int
    improper: int
    found: float
    wrongly_dropped: float
    unproven: int


Stressed = Finished[NoSettings, StressBlock]


def stress_tasks(request: CampaignRequest, settings: NoSettings) -> list[Task]:
    """One task for each block of runs of either trial."""
    return [
        {"key": f"{name}-{request.seed}-{first}-{min(_BLOCK, request.runs - first)}", "trial": name,
         "seed": request.seed, "first": first, "count": min(_BLOCK, request.runs - first)}
        for name in TRIALS
        for first in range(0, request.runs, _BLOCK)
    ]  # fmt: skip


def block_row(task: Task) -> dict[str, Any]:
    """A campaign's row: ``count`` runs of the trial ``trial`` from ``first`` on."""
    runs = range(int(task["first"]), int(task["first"]) + int(task["count"]))
    attempts, bounds = attempted(TRIALS[task["trial"]], runs, int(task["seed"]))
    return {"trial": task["trial"], "attempts": [list(each) for each in attempts], "bounds": bounds}


def attempted(
    trial: StressTrial, runs: Iterable[int], seed: int, only: Sequence[Method] = tuple(Method)
) -> tuple[list[SolverAttempt], list[list[float]]]:
    """Every method, or ``only`` some, in each of the runs, and the bound of the good samples in each."""
    n = scenes.noise(trial.rotation_deg, trial.translation_mm)
    attempts, bounds = [], []
    for run in runs:
        rng = np.random.default_rng([seed, run])
        scene = trial.scene(rng)
        pairs, spoiled = scenes.measured_with_bad(scene, n, rng, trial.bad)
        good = np.array([k for k in range(trial.samples) if str(k + 1) not in spoiled])
        bounds.append(list(scenes.bound(scene._replace(X_BT=scene.X_BT[good]), n)))
        for method in only:
            try:
                attempts.append(_attempt(methods.solve(pairs, method), scene.X, spoiled))
            except MeasurementFailed:
                attempts.append(SolverAttempt(method.value))
    return attempts, bounds


def _attempt(result: HandEyeResult, truth: Array, bad: set[str]) -> SolverAttempt:
    R = result.X[:3, :3]
    orthonormal = np.isfinite(result.X).all() and np.abs(R.T @ R - np.eye(3)).max() <= 1e-9
    if not orthonormal or np.linalg.det(R) < 0.999:
        return SolverAttempt(result.method, improper=True)
    dropped = {name for name, inlier in zip(result.names, result.inliers, strict=True) if not inlier}
    proven = None if result.certificate is None else result.certificate.holds
    error = se3.local(result.X, truth).tolist()
    return SolverAttempt(result.method, error, False, len(dropped & bad), len(dropped - bad), proven)


def rows_of(trial: StressTrial, attempts: Sequence[SolverAttempt], bounds: Sequence[Any]) -> list[StressRow]:
    """A row for each method."""
    bound_mm = float(np.sqrt(np.mean(np.square(np.array(bounds)[:, 1]))))
    rows = []
    for method in dict.fromkeys(attempt.method for attempt in attempts):
        mine = [attempt for attempt in attempts if attempt.method == method]
        ended = [attempt for attempt in mine if attempt.error is not None]
        errors = np.array([attempt.error for attempt in ended]).reshape(-1, 2, 3)
        sizes = np.linalg.norm(errors, axis=-1) if len(errors) else np.full((1, 2), np.nan)
        shift, turn = 1e3 * sizes[:, 0], np.degrees(sizes[:, 1])
        improper, runs = sum(attempt.improper for attempt in mine), max(len(ended), 1)
        rows.append(
            StressRow(
                method,
                len(mine),
                float(np.median(turn)),
                float(np.sqrt(np.mean(turn**2))),
                float(np.median(shift)),
                float(np.sqrt(np.mean(shift**2))),
                float(np.quantile(shift, 0.95)),
                bound_mm,
                len(mine) - len(ended) - improper,
                improper,
                sum(attempt.bad_found for attempt in ended) / max(trial.bad * runs, 1),
                sum(attempt.good_lost for attempt in ended) / ((trial.samples - trial.bad) * runs),
                sum(attempt.proven is False for attempt in ended),
            )
        )
    return rows


def _by_trial(done: Stressed) -> dict[str, list[StressRow]]:
    demand_all(done.rows)
    made = {}
    for name, trial in TRIALS.items():
        blocks = [row for row in done.rows if row.trial == name]
        attempts = [SolverAttempt(*each) for block in blocks for each in block.attempts or ()]
        made[name] = rows_of(trial, attempts, [bound for block in blocks for bound in block.bounds or ()])
    return made


def stress_tables(done: Stressed) -> list[Table]:
    """Every method, a table a trial."""
    columns: Columns = {
        "method": "{method}",
        "median deg": "{rotation_median_deg:.4f}",
        "rms deg": "{rotation_rms_deg:.4f}",
        "median mm": "{translation_median_mm:.2f}",
        "rms mm": "{translation_rms_mm:.2f}",
        "95 % mm": "{translation_95_mm:.2f}",
        "bound mm": "{bound_translation_mm:.2f}",
        "refused": "{refused}",
        "improper": "{improper}",
        "bad found": "{found:.1%}",
        "good lost": "{wrongly_dropped:.1%}",
        "unproven": "{unproven}",
    }
    return [listed(f"{name}, {rows[0].runs} runs", columns, rows) for name, rows in _by_trial(done).items()]


def stress_verdict(done: Stressed) -> list[Check]:
    """Bad samples and small rotations leave the robust solver usable, and no method improper."""
    made = _by_trial(done)
    bad, small = (
        next(row for row in made[trial.name] if row.method == Method.ROBUST.value)
        for trial in (BAD_SAMPLES, SMALL_ROTATIONS)
    )
    improper = sum(row.improper for rows in made.values() for row in rows)
    limit_mm = 7.0 if done.request.runs >= _ENOUGH else None
    return [
        at_most(f"NaN or left-handed, by any method in 2 × {done.request.runs} runs", improper, 0),
        at_most("bad samples: median", bad.rotation_median_deg, 0.1, "°"),
        at_most("bad samples: median", bad.translation_median_mm, 3.0, "mm"),
        at_most("small rotations: rms", small.translation_rms_mm, limit_mm, "mm"),
    ]


STRESS = Experiment(
    name="hua-stress",
    title="Two bad samples of fifteen, and rotations under 5°, with every method.",
    settings=NoSettings,
    row=StressBlock,
    tasks=stress_tasks,
    run=block_row,
    table=stress_tables,
    verdict=stress_verdict,
    figures=lambda done: {"trials": _by_trial(done)},
    runs=200,
    world="drawn scenes",
    eyes="none: poses with noise",
    configured=False,
)
