"""`longreach experiment hua`: localisation (Fig. 5 and 6) and noise (Fig. 7) of Hua et al. 2024."""

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Check, Experiment, Finished
from laboratory.campaigns.workforce import Task
from laboratory.experiments.hand_eye import localisation
from laboratory.experiments.hand_eye.localisation import LocalisationRow
from laboratory.experiments.hand_eye.noise_sweep import NoiseOn, SweepRow, level_of
from protocol.errors import MeasurementFailed
from testbed.reporting.console import Columns, listed
from vision_pc.config.choices import Method

_ENOUGH = 100  # runs: with fewer, chance decides whether a mean is inside its limits


class LocalisationSettings(NamedTuple):
    """How often each target is located."""

    repetitions: Annotated[int, typer.Option(min=1, help="Localisations of each task.")] = 50


class NoiseSettings(NamedTuple):
    """What is noisy, and how much."""

    noise_on: Annotated[NoiseOn, typer.Option(help="What is noisy.")] = NoiseOn.CAMERA_POSES
    largest: Annotated[int, typer.Option(min=1, help="Levels d = 1 … this.")] = 10


class NoiseLevel(NamedTuple):
    """A campaign's row: all methods at one level."""

    rows: list[dict[str, Any]] | None
    failure: str
    cpu_s: float


class LocalisedRun(NamedTuple):
    """A campaign's row: all methods in one calibration."""

    entries: list[Any] | None
    failure: str
    cpu_s: float


Swept = Finished[NoiseSettings, NoiseLevel]
Located = Finished[LocalisationSettings, LocalisedRun]


def demand_all(rows: Iterable[Any]) -> None:
    """Raise MeasurementFailed with the cause of the first run that failed."""
    if failed := next((row.failure for row in rows if row.failure), None):
        raise MeasurementFailed("measurement.run_failed", failed)


def sweep_tasks(request: CampaignRequest, settings: NoiseSettings) -> list[Task]:
    """One task a level, with all its runs."""
    noise_on, runs, seed = settings.noise_on.value, request.runs, request.seed
    asked = {"noise_on": noise_on, "runs": runs, "seed": seed}
    levels = range(1, settings.largest + 1)
    return [{"key": f"{noise_on}-{runs}-{seed}-{level}", "level": level} | asked for level in levels]


def _sweep(done: Swept) -> list[SweepRow]:
    demand_all(done.rows)
    return [SweepRow(**row) for level in done.rows for row in level.rows or ()]


def sweep_tables(done: Swept) -> list[Table]:
    """The first and the last level."""
    return [_level_table(_sweep(done), level) for level in sorted({1, done.settings.largest})]


def _level_table(rows: Sequence[SweepRow], level: int) -> Table:
    """One noise level of the sweep."""
    shown = [r for r in rows if r.level == level]
    first = shown[0]
    title = (
        f"d = {level}, noise on {first.noise_on}, {first.runs} runs; Cramér-Rao bound "
        f"{first.bound_rotation_deg:.4f} deg {first.bound_translation_mm:.3f} mm"
    )
    columns: Columns = {
        "method": "{method}",
        "deg": "{rotation_deg:.4f}",
        "mm": "{translation_mm:.3f}",
        "deg / bound": "{rotation_over_bound:.2f}",
        "mm / bound": "{translation_over_bound:.2f}",
        "NEES": "{nees:.2f}",
        "least eigenvalue": "{least_eigenvalue:.1e}",
        "failed": "{failed}",
    }
    return listed(title, columns, shown)


def sweep_verdict(done: Swept) -> list[Check]:
    """What is asked of the sweep (Fig. 7)."""
    rows, runs = _sweep(done), done.request.runs
    failed = sum(r.failed for r in rows)
    checks = [Check("runs that failed", str(failed), "0", failed == 0)]
    eigenvalues = [r.least_eigenvalue for r in rows if r.least_eigenvalue is not None]
    if eigenvalues:
        least = min(eigenvalues)
        checks.append(Check("certificate, the worst run", f"{least:.1e}", "≥ -1e-9", least >= -1e-9))
    return checks if runs < _ENOUGH else [*checks, *_checks_by_bound(rows, done.settings.noise_on, runs)]


def _checks_by_bound(rows: Sequence[SweepRow], noise_on: NoiseOn, runs: int) -> list[Check]:
    """The best method against the Cramér-Rao bound, its own covariance and DQCR."""
    best = Method.MAXIMUM_LIKELIHOOD if noise_on is NoiseOn.CAMERA_MOTIONS else Method.ROBUST
    mine = [r for r in rows if r.method == best.value]
    rotation, translation = (
        float(np.sqrt(np.mean([getattr(r, name) ** 2 for r in mine])))
        for name in ("rotation_over_bound", "translation_over_bound")
    )
    worst = max(max(r.rotation_over_bound, r.translation_over_bound) for r in mine)
    limit = 1.1 if noise_on is NoiseOn.CAMERA_POSES else 1.2
    checks = [
        Check(
            f"{best} over the bound, all levels (a level's own figure is sure to about"
            f" {100.0 / np.sqrt(2.0 * runs):.0f} %)",
            f"{rotation:.3f} in rotation, {translation:.3f} in translation; the worst level {worst:.3f}",
            f"≤ {limit:g}",
            max(rotation, translation) <= limit,
        )
    ]
    nees = [r.nees for r in mine if r.nees is not None]
    if nees:
        text = f"{min(nees):.2f} … {max(nees):.2f}"
        checks.append(Check("its mean NEES", text, "5 … 7", min(nees) >= 5.0 and max(nees) <= 7.0))
    if noise_on is NoiseOn.CAMERA_POSES:
        dqcr = {r.level: r.rotation_deg for r in rows if r.method == Method.DQCR.value}
        ratio = min(dqcr[r.level] / r.rotation_deg for r in mine)
        checks.append(Check("times below DQCR in rotation", f"{ratio:.2f}", "≥ 5", ratio >= 5.0))
    return checks


NOISE = Experiment(
    name="hua-noise",
    title="Errors of X as noise grows, beside the Cramér-Rao bound.",
    settings=NoiseSettings,
    row=NoiseLevel,
    tasks=sweep_tasks,
    run=level_of,
    table=sweep_tables,
    verdict=sweep_verdict,
    figures=lambda done: {"rows": _sweep(done)},
    runs=200,
    world="poses of the paper's Table 1",
    eyes="none: poses with noise",
    configured=False,
)


def localisation_tasks(request: CampaignRequest, settings: LocalisationSettings) -> list[Task]:
    """One task a calibration."""
    seed, repetitions = request.seed, settings.repetitions
    asked = {"repetitions": repetitions, "seed": seed}
    return [{"key": f"{seed}-{repetitions}-{run}", "run": run} | asked for run in range(request.runs)]


def _localisation_rows(done: Located) -> list[LocalisationRow]:
    demand_all(done.rows)
    return list(localisation.rows_of([localisation.entries_of(row.entries or []) for row in done.rows]))


def localisation_verdict(done: Located) -> list[Check]:
    """The robust solver, bad samples included, locates better than the paper's best (Fig. 5, 6)."""
    everything = {(r.method, r.samples): r for r in _localisation_rows(done) if r.task == "all"}
    robust = everything.get((Method.ROBUST.value, f"all {localisation.TAKEN}"))
    dqcr = everything[(Method.DQCR.value, f"{localisation.KEPT} kept by hand")]
    return [
        Check(
            "robust on all samples, against DQCR on those kept by hand",
            "failed" if robust is None else f"{robust.error_mm:.2f} mm",
            f"< {dqcr.error_mm:.2f} mm",
            robust is not None and robust.failed == 0 and robust.error_mm < dqcr.error_mm,
        )
    ]


def localisation_table(rows: Iterable[LocalisationRow]) -> Table:
    """Fig. 5 and 6: all tasks together."""
    columns: Columns = {
        "method": "{method}",
        "samples": "{samples}",
        "mm": "{error_mm:.2f}",
        "5 % … 95 %": "{lowest_mm:.2f} … {highest_mm:.2f}",
        "by X alone": "{from_calibration_mm:.2f}",
        "paper mm": "{paper_mm:.1f}",
        "within 3 mm": "{recognised_percent:.0f} %",
        "paper": "{paper_recognised_percent:.0f} %",
        "failed": "{failed}",
    }
    return listed("localisation of knob, switch and key hole", columns, (r for r in rows if r.task == "all"))


LOCALISATION = Experiment(
    name="hua-localisation",
    title="Localisation of knob, switch and key hole with every method.",
    settings=LocalisationSettings,
    row=LocalisedRun,
    tasks=localisation_tasks,
    run=localisation.calibration_row,
    table=lambda done: [localisation_table(_localisation_rows(done))],
    verdict=localisation_verdict,
    figures=lambda done: {"rows": _localisation_rows(done)},
    runs=50,
    world="poses of the paper's Table 1, with 5 bad samples of 17",
    eyes="none: poses with noise",
    configured=False,
)
