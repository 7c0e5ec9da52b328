"""`longreach experiment hua --method stress`: bad samples among the good, booms that hardly turn."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Check, Experiment, Finished, NoSettings, at_most, demand_all
from laboratory.campaigns.workforce import Task
from laboratory.experiments.hand_eye import scenes
from laboratory.experiments.hand_eye.noise_sweep import SolverAttempt, attempt, sizes
from laboratory.experiments.hand_eye.scenes import HandEyeScene
from testbed.reporting.console import Columns, listed
from vision_pc.config.choices import Method

_ENOUGH = 100  # runs: with fewer, chance decides
_BLOCK = 25  # runs of a row


class StressTrial(NamedTuple):
    """One way to break calibrations: noise, how many samples and bad ones, from where they are seen."""

    name: str
    samples: int
    bad: int
    rotation_deg: float
    translation_mm: float
    scene: Callable[[np.random.Generator, int], HandEyeScene]


BAD_SAMPLES = StressTrial("2 of 15 bad", 15, 2, 0.1, 1.0, scenes.viewing_scene)
SMALL_ROTATIONS = StressTrial("rotations under 5 deg", 20, 0, 0.05, 0.5, scenes.small_rotation_scene)
TRIALS = {trial.name: trial for trial in (BAD_SAMPLES, SMALL_ROTATIONS)}


class StressRow(NamedTuple):
    """One method over all runs of a trial."""

    method: str
    runs: int
    rotation_median_deg: float
    translation_median_mm: float
    translation_rms_mm: float
    refused: int
    improper: int
    found: float


def stress_tasks(request: CampaignRequest, settings: NoSettings) -> list[Task]:
    """One task for each block of runs of either trial."""
    return [
        {"key": f"{name}-{request.seed}-{first}-{min(_BLOCK, request.runs - first)}", "trial": name,
         "seed": request.seed, "first": first, "count": min(_BLOCK, request.runs - first)}
        for name in TRIALS
        for first in range(0, request.runs, _BLOCK)
    ]  # fmt: skip


def block_row(_config_dir: Path, task: Task) -> dict[str, Any]:
    """A campaign's row: ``count`` runs of the trial ``trial`` from ``first`` on."""
    runs = range(task["first"], task["first"] + task["count"])
    return {"attempts": [list(each) for each in attempted(TRIALS[task["trial"]], runs, task["seed"])]}


def attempted(
    trial: StressTrial, runs: Iterable[int], seed: int, only: Sequence[Method] = tuple(Method)
) -> list[SolverAttempt]:
    """Every method, or ``only`` some, in each of the runs."""
    n = scenes.noise(trial.rotation_deg, trial.translation_mm)
    attempts: list[SolverAttempt] = []
    for run in runs:
        rng = np.random.default_rng([seed, run])
        scene = trial.scene(rng, trial.samples)
        pairs, spoiled = scenes.measured_with_bad(scene, n, rng, trial.bad)
        attempts += [attempt(pairs, method, scene.X, spoiled) for method in only]
    return attempts


def rows_of(trial: StressTrial, attempts: Sequence[SolverAttempt]) -> list[StressRow]:
    """A row for each method."""
    rows = []
    for method in dict.fromkeys(one.method for one in attempts):
        mine = [one for one in attempts if one.method == method]
        ended = [one for one in mine if one.error is not None]
        shift, turn = sizes(mine)
        improper = sum(one.improper for one in mine)
        rows.append(
            StressRow(
                method,
                len(mine),
                float(np.median(turn)),
                float(np.median(shift)),
                float(np.sqrt(np.mean(shift**2))),
                len(mine) - len(ended) - improper,
                improper,
                sum(one.bad_found for one in ended) / max(trial.bad * len(ended), 1),
            )
        )
    return rows


def _by_trial(done: Finished[NoSettings]) -> dict[str, list[StressRow]]:
    demand_all(done.rows)
    made = {}
    for name, trial in TRIALS.items():
        blocks = [row["attempts"] for row in done.rows if row["trial"] == name]
        made[name] = rows_of(trial, [SolverAttempt(*each) for block in blocks for each in block])
    return made


def stress_tables(done: Finished[NoSettings]) -> list[Table]:
    """Every method, a table a trial."""
    columns: Columns = {
        "method": "{method}",
        "median deg": "{rotation_median_deg:.4f}",
        "median mm": "{translation_median_mm:.2f}",
        "rms mm": "{translation_rms_mm:.2f}",
        "refused": "{refused}",
        "improper": "{improper}",
        "bad found": "{found:.1%}",
    }
    return [listed(f"{name}, {rows[0].runs} runs", columns, rows) for name, rows in _by_trial(done).items()]


def stress_verdict(done: Finished[NoSettings]) -> list[Check]:
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
    settings=NoSettings,
    tasks=stress_tasks,
    run=block_row,
    tables=stress_tables,
    verdict=stress_verdict,
    runs=200,
    world="drawn scenes",
    eyes="none: poses with noise",
)
