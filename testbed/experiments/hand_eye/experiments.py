"""The experiments as the command runs them: rows, tables, plots, and whether what was wanted was reached."""

from pathlib import Path
from typing import Any

import numpy as np

from protocol.errors import MeasurementFailed, RequestRefused
from testbed.campaigns.campaign import Run, run_campaign
from testbed.experiments.hand_eye import intrinsics_experiment, localisation, noise_sweep, real_data, stress
from testbed.experiments.hand_eye import plots as experiment_plots
from testbed.experiments.hand_eye import tables as experiment_tables
from testbed.experiments.hand_eye.check import Check, concluded
from testbed.experiments.hand_eye.noise_sweep import NoiseOn, Sweep
from testbed.reporting.console import bars, out
from vision_pc.core.hand_eye.solvers.methods import Method

_ENOUGH = 100  # runs: with fewer, chance decides whether a mean is inside its limits
LARGEST_DQCR_DIFFERENCE = 1e-6


def run_noise_sweep(
    noise_on: NoiseOn,
    runs: int,
    largest: int,
    seed: int,
    plot: Path | None,
    json_file: Path | None,
    directory: Path,
    scheduler: str | None = None,
) -> bool:
    """Whether the sweep (Fig. 7) came out as wanted; levels that ``directory`` holds are not made again.

    Raises MeasurementFailed with the cause of the first level that could not be made.
    """
    asked = {"noise_on": noise_on.value, "runs": runs, "seed": seed}
    tasks = [{"key": f"{noise_on}-{runs}-{seed}-{d}", "level": d} | asked for d in range(1, largest + 1)]
    title = f"noise on {noise_on}"
    levels = _made(directory, noise_sweep.level_of, tasks, scheduler, title)
    sweep = noise_sweep.gathered(levels)
    for level in sorted({1, largest}):
        out.print(experiment_tables.sweep_table(sweep.rows, level))
    checks = _sweep_checks(sweep, noise_on, runs)
    if plot is not None:
        experiment_plots.sweep_plot(sweep.rows, plot)
    return concluded(checks, sweep.as_json(), json_file)


def _sweep_checks(sweep: Sweep, noise_on: NoiseOn, runs: int) -> list[Check]:
    checks = [
        Check(
            "DQCR published and closed form equal to 1e-6",
            f"{sweep.dqcr_difference:.1e}",
            sweep.dqcr_difference <= LARGEST_DQCR_DIFFERENCE,
        ),
        Check("no run failed", str(sum(r.failed for r in sweep.rows)), not any(r.failed for r in sweep.rows)),
    ]
    eigenvalues = [r.least_eigenvalue for r in sweep.rows if r.least_eigenvalue is not None]
    if eigenvalues:
        checks.append(
            Check("certificate ≥ -1e-9 in every run", f"{min(eigenvalues):.1e}", min(eigenvalues) >= -1e-9)
        )
    if runs < _ENOUGH:
        return checks
    best = Method.MAXIMUM_LIKELIHOOD if noise_on is NoiseOn.CAMERA_MOTIONS else Method.ROBUST
    mine = [r for r in sweep.rows if r.method == best.value]
    rotation, translation = (
        float(np.sqrt(np.mean([getattr(r, name) ** 2 for r in mine])))
        for name in ("rotation_over_bound", "translation_over_bound")
    )
    worst = max(max(r.rotation_over_bound, r.translation_over_bound) for r in mine)
    limit = 1.1 if noise_on is NoiseOn.CAMERA_POSES else 1.2
    checks.append(
        Check(
            f"{best} at most {limit} times the bound over all levels (a level's own figure is sure to about"
            f" {100.0 / np.sqrt(2.0 * runs):.0f} %)",
            f"{rotation:.3f} in rotation, {translation:.3f} in translation; the worst level {worst:.3f}",
            max(rotation, translation) <= limit,
        )
    )
    nees = [r.nees for r in mine if r.nees is not None]
    if nees:
        text = f"{min(nees):.2f} … {max(nees):.2f}"
        checks.append(Check("its mean NEES in 5 … 7", text, min(nees) >= 5.0 and max(nees) <= 7.0))
    if noise_on is NoiseOn.CAMERA_POSES:
        dqcr = {r.level: r.rotation_deg for r in sweep.rows if r.method == Method.DQCR.value}
        ratio = min(dqcr[r.level] / r.rotation_deg for r in mine)
        checks.append(Check("at least 5 times below DQCR in rotation", f"{ratio:.2f}", ratio >= 5.0))
    return checks


def run_localisation(
    runs: int,
    repetitions: int,
    seed: int,
    plot: Path | None,
    json_file: Path | None,
    directory: Path,
    scheduler: str | None = None,
) -> bool:
    """Whether the robust solver, bad samples included, locates better than the paper's best (Fig. 5, 6)."""
    asked = {"repetitions": repetitions, "seed": seed}
    tasks = [{"key": f"{seed}-{repetitions}-{run}", "run": run} | asked for run in range(runs)]
    made = _made(directory, localisation.calibration_row, tasks, scheduler, f"{runs} calibrations")
    rows = localisation.rows_of([localisation.entries_of(row) for row in made])
    out.print(experiment_tables.localisation_table(rows))
    everything = {(r.method, r.samples): r for r in rows if r.task == "all"}
    robust = everything.get((Method.ROBUST.value, f"all {localisation.TAKEN}"))
    dqcr = everything[(Method.DQCR.value, f"{localisation.KEPT} kept by hand")]
    checks = [
        Check(
            "robust on all samples below DQCR on those kept by hand, mm",
            "failed" if robust is None else f"{robust.error_mm:.2f} < {dqcr.error_mm:.2f}",
            robust is not None and robust.failed == 0 and robust.error_mm < dqcr.error_mm,
        )
    ]
    if plot is not None:
        experiment_plots.localisation_plot(rows, plot)
    return concluded(checks, {"rows": [r.as_json() for r in rows]}, json_file)


def run_intrinsics(
    runs: int,
    views: int,
    seed: int,
    plot: Path | None,
    json_file: Path | None,
    directory: Path,
    scheduler: str | None = None,
) -> bool:
    """Whether Zhang's method finds the emulated camera and, where its pictures are, OpenCV's real one."""
    asked = {"views": views, "seed": seed}
    tasks = [{"key": f"{seed}-{views}-{run}", "run": run} | asked for run in range(runs)]
    made = _made(directory, intrinsics_experiment.calibration_row, tasks, scheduler, f"{runs} calibrations")
    rows = intrinsics_experiment.rows_of(made)
    boards = [
        abs(r.fx_error_percent) for r in rows if r.fx_error_percent is not None and r.detector != "charuco"
    ]
    checks = [Check("fx of the emulated camera within 0.3 %", f"{max(boards):.3f} %", max(boards) <= 0.3)]
    try:
        rows += real_data.checkerboards()
    except RequestRefused as error:
        out.print(f"real pictures left out: {error}", style="yellow", highlight=False)
    else:
        classic = next(r for r in rows if r.pictures.startswith("OpenCV") and r.detector == "classic")
        off = 100.0 * (classic.fx_px / real_data.OPENCV_FX_PX - 1.0)
        checks.append(
            Check("fx of the real pictures within 0.3 % of OpenCV's", f"{off:+.3f} %", abs(off) <= 0.3)
        )
    out.print(experiment_tables.intrinsics_table(rows))
    if plot is not None:
        experiment_plots.intrinsics_plot(made[0]["maps"], plot)
    return concluded(checks, {"rows": [r.as_json() for r in rows]}, json_file)


def run_stress(
    runs: int, seed: int, json_file: Path | None, directory: Path, scheduler: str | None = None
) -> bool:
    """Whether bad samples and small rotations leave the robust solver usable, and no method improper."""
    tasks = [
        {"key": f"{trial.name}-{seed}-{first}-{count}", "trial": trial.name, "seed": seed, "first": first,
         "count": count}
        for trial in (stress.BAD_SAMPLES, stress.SMALL_ROTATIONS)
        for first, count in _blocks(runs)
    ]  # fmt: skip
    made = _made(directory, stress.block_row, tasks, scheduler, f"2 × {runs} runs")
    bad, small = (stress.rows_of(trial, made) for trial in (stress.BAD_SAMPLES, stress.SMALL_ROTATIONS))
    for rows in (bad, small):
        out.print(experiment_tables.stress_table(rows))
    among_bad = next(r for r in bad if r.method == Method.ROBUST.value)
    turning_little = next(r for r in small if r.method == Method.ROBUST.value)
    improper = sum(r.improper for r in (*bad, *small))
    what = f"never NaN, never left-handed, by any method in 2 × {runs} runs"
    checks = [
        Check(what, str(improper), improper == 0),
        _at_most("bad samples: median, deg", among_bad.rotation_median_deg, 0.1),
        _at_most("bad samples: median, mm", among_bad.translation_median_mm, 3.0),
    ]
    bound = f"small rotations (Cramér-Rao bound {turning_little.bound_translation_mm:.2f}): rms, mm"
    if runs >= _ENOUGH:
        checks.append(_at_most(bound, turning_little.translation_rms_mm, 7.0))
    else:
        out.print(f"{bound}: {turning_little.translation_rms_mm:.4g}; judged from {_ENOUGH} runs on")
    return concluded(checks, {"rows": [r.as_json() for r in (*bad, *small)]}, json_file)


def _blocks(runs: int, size: int = 25) -> list[tuple[int, int]]:
    """First run and count of each block of at most ``size`` runs."""
    return [(first, min(size, runs - first)) for first in range(0, runs, size)]


def _made(
    directory: Path, function: Run, tasks: list[dict[str, Any]], scheduler: str | None, title: str
) -> list[dict[str, Any]]:
    """A campaign's rows. Raises MeasurementFailed with the cause of the first run that failed."""
    rows = run_campaign(directory, function, tasks, scheduler=scheduler, title=title)
    if failed := next((row["failure"] for row in rows if row["failure"]), None):
        raise MeasurementFailed("measurement.run_failed", f"{title}: {failed}")
    return rows


def run_real_data(json_file: Path | None) -> bool:
    """Whether the recorded sets come out as published. Raises RequestRefused where they are absent."""
    with bars() as shown, shown.step("recorded sets") as bar:
        reference = real_data.moveit_reference()
        rows = real_data.hold_out("moveit", real_data.moveit(), reference)
        bar.update(0.5)
        rows += real_data.hold_out("ethz_arm_sim", real_data.ethz())
    out.print(experiment_tables.hold_out_table(rows))
    robust = {r.data: r for r in rows if r.method == Method.ROBUST.value}
    moveit, ethz = robust["moveit"], robust["ethz_arm_sim"]
    off = moveit.off_mm if moveit.off_mm is not None else float("inf")
    share = 0.1 * off / float((real_data.MOVEIT_TRANSLATION**2).sum() ** 0.5)
    checks = [
        Check(
            "moveit within 1 % of the published translation", f"{off:.2f} mm = {share:.2f} %", share <= 1.0
        ),
        Check("ethz_arm_sim hold-out ≤ 1.6 mm", f"{ethz.hold_out_mm:.3f} mm", ethz.hold_out_mm <= 1.6),
    ]
    return concluded(checks, {"rows": [r.as_json() for r in rows]}, json_file)


def _at_most(what: str, value: float, limit: float) -> Check:
    return Check(f"{what}, at most {limit:g}", f"{value:.4g}", value <= limit)
