"""`longreach experiment hua`: localisation (Fig. 5 and 6) and noise (Fig. 7) of Hua et al. 2024."""

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Check, Experiment, Finished, NoSettings, demand_all
from laboratory.campaigns.workforce import Task
from laboratory.experiments.hand_eye.localisation import (
    KEPT,
    PAPER_MM,
    PAPER_RECOGNITION,
    TAKEN,
    TOLERANCE_MM,
    Errors,
    calibration_row,
    errors_of,
)
from laboratory.experiments.hand_eye.noise_sweep import SweepRow, level_of
from testbed.reporting.console import Columns, listed, table
from vision_pc.config.choices import Method

_ENOUGH = 100  # runs: with fewer, chance decides whether a mean is inside its limits


LEVELS = 10
REPETITIONS = 50  # localisations of each target


def sweep_tasks(request: CampaignRequest, settings: NoSettings) -> list[Task]:
    """One task a level, with all its runs."""
    key, common = f"{request.runs}-{request.seed}", {"runs": request.runs, "seed": request.seed}
    return [{"key": f"{key}-{level}", "level": level} | common for level in range(1, LEVELS + 1)]


def _sweep(done: Finished[NoSettings]) -> list[SweepRow]:
    demand_all(done.rows)
    return [SweepRow(**row) for level in done.rows for row in level["rows"]]


def sweep_tables(done: Finished[NoSettings]) -> list[Table]:
    """The first and the last level."""
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
    shown = [[row for row in _sweep(done) if row.level == level] for level in (1, LEVELS)]
    return [
        listed(
            f"d = {first.level}, {done.request.runs} runs; Cramér-Rao bound "
            f"{first.bound_rotation_deg:.4f} deg {first.bound_translation_mm:.3f} mm",
            columns,
            [first, *others],
        )
        for first, *others in shown
    ]


def sweep_verdict(done: Finished[NoSettings]) -> list[Check]:
    """What is asked of the sweep (Fig. 7)."""
    rows, runs = _sweep(done), done.request.runs
    failed = sum(r.failed for r in rows)
    checks = [Check("runs that failed", str(failed), "0", failed == 0)]
    eigenvalues = [r.least_eigenvalue for r in rows if r.least_eigenvalue is not None]
    if eigenvalues:
        least = min(eigenvalues)
        checks.append(Check("certificate, the worst run", f"{least:.1e}", "≥ -1e-9", least >= -1e-9))
    return checks if runs < _ENOUGH else [*checks, *_checks_by_bound(rows, runs)]


def _checks_by_bound(rows: Sequence[SweepRow], runs: int) -> list[Check]:
    """The robust method against the Cramér-Rao bound, its own covariance and DQCR."""
    mine = [r for r in rows if r.method == Method.ROBUST.value]
    over = np.array([(r.rotation_over_bound, r.translation_over_bound) for r in mine])
    rotation, translation = np.sqrt(np.mean(over**2, axis=0))
    nees = [r.nees for r in mine if r.nees is not None]
    honest = 5.0 <= min(nees) <= max(nees) <= 7.0
    dqcr = {r.level: r.rotation_deg for r in rows if r.method == Method.DQCR.value}
    ratio = min(dqcr[r.level] / r.rotation_deg for r in mine)
    return [
        Check(
            "robust over the bound, all levels (a level's own figure is sure to about"
            f" {100.0 / np.sqrt(2.0 * runs):.0f} %)",
            f"{rotation:.3f} in rotation, {translation:.3f} in translation; the worst level {over.max():.3f}",
            "≤ 1.1",
            bool(max(rotation, translation) <= 1.1),
        ),
        Check(
            "its mean NEES",
            f"{min(nees):.2f} … {max(nees):.2f}",
            "5 … 7",
            honest,
        ),
        Check("times below DQCR in rotation", f"{ratio:.2f}", "≥ 5", ratio >= 5.0),
    ]


NOISE = Experiment(
    name="hua-noise",
    settings=NoSettings,
    tasks=sweep_tasks,
    run=level_of,
    tables=sweep_tables,
    verdict=sweep_verdict,
    runs=200,
    world="poses of the paper's Table 1",
    eyes="none: poses with noise",
)


def localisation_tasks(request: CampaignRequest, settings: NoSettings) -> list[Task]:
    """One task a calibration."""
    common: Task = {"repetitions": REPETITIONS, "seed": request.seed}
    return [{"key": f"{request.seed}-{run}", "run": run} | common for run in range(request.runs)]


def _errors(done: Finished[NoSettings]) -> Errors:
    demand_all(done.rows)
    return errors_of(row["entries"] for row in done.rows)


def localisation_verdict(done: Finished[NoSettings]) -> list[Check]:
    """The robust solver, bad samples included, locates better than the paper's best (Fig. 5, 6)."""
    errors = _errors(done)
    robust, dqcr = (
        float(errors[key].mean())
        for key in ((Method.ROBUST.value, f"all {TAKEN}"), (Method.DQCR.value, f"{KEPT} kept by hand"))
    )
    what = "robust on all samples, against DQCR on those kept by hand"
    return [Check(what, f"{robust:.2f} mm", f"< {dqcr:.2f} mm", robust < dqcr)]


def localisation_tables(done: Finished[NoSettings]) -> list[Table]:
    """Fig. 5 and 6: mean errors, and how many points lie within the key hole's clearance."""
    heads = ("method", "samples", "mm", "paper mm", f"within {TOLERANCE_MM:g} mm", "paper", "failed")
    cells = [
        (
            *key,
            f"{np.nanmean(mm):.2f}",
            PAPER_MM.get(key[0], "–"),
            f"{np.mean(mm[np.isfinite(mm)] <= TOLERANCE_MM):.0%}",
            PAPER_RECOGNITION.get(key[0], "–"),
            int(np.isnan(mm).any(axis=(1, 2)).sum()),
        )
        for key, mm in _errors(done).items()
    ]
    return [table("localisation of knob, switch and key hole", heads, cells)]


LOCALISATION = Experiment(
    name="hua-localisation",
    settings=NoSettings,
    tasks=localisation_tasks,
    run=calibration_row,
    tables=localisation_tables,
    verdict=localisation_verdict,
    runs=50,
    world="poses of the paper's Table 1, with 5 bad samples of 17",
    eyes="none: poses with noise",
)
