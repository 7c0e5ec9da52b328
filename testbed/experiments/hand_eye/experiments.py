"""The experiments of Hua et al. 2024: tasks, tables, plots, and what is asked of their rows."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from protocol.errors import MeasurementFailed, RequestRefused
from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished, NoSettings, show_checks
from testbed.experiments.hand_eye import intrinsics_experiment, localisation, noise_sweep, real_data, stress
from testbed.experiments.hand_eye import plots as experiment_plots
from testbed.experiments.hand_eye import tables as experiment_tables
from testbed.experiments.hand_eye.intrinsics_experiment import IntrinsicsRow
from testbed.experiments.hand_eye.localisation import LocalisationRow
from testbed.experiments.hand_eye.noise_sweep import NoiseOn, NoiseSweep
from testbed.experiments.hand_eye.real_data import HoldOutRow
from testbed.experiments.hand_eye.stress import StressRow
from testbed.reporting.console import bars, out, write_json
from vision_pc.config.choices import Method
from vision_pc.core.hand_eye.solvers.methods import CLASSICAL

_ENOUGH = 100  # runs: with fewer, chance decides whether a mean is inside its limits
LARGEST_DQCR_DIFFERENCE = 1e-6
_BEHIND = 1.02  # of the best classical method's hold-out error


class NestedRow(NamedTuple):
    """One campaign row that holds many figures: all of a level, a calibration, a block of runs."""

    key: str
    rows: list[dict[str, Any]] | None
    maps: list[dict[str, Any]] | None
    entries: list[Any] | None
    trial: str
    tallies: dict[str, Any] | None
    bounds: list[Any] | None
    dqcr_largest_difference: float
    failure: str
    cpu_s: float


def _made(rows: Sequence[NestedRow]) -> list[dict[str, Any]]:
    """The rows' cells. Raises MeasurementFailed with the cause of the first run that failed."""
    if failed := next((row.failure for row in rows if row.failure), None):
        raise MeasurementFailed("measurement.run_failed", failed)
    return [row._asdict() for row in rows]


class SweepSettings(NamedTuple):
    """What is noisy, and how much."""

    noise_on: Annotated[NoiseOn, typer.Option(help="What is noisy.")] = NoiseOn.CAMERA_POSES
    largest: Annotated[int, typer.Option(min=1, help="Levels d = 1 … this.")] = 10


Swept = Finished[SweepSettings, NestedRow]


def sweep_tasks(request: CampaignRequest, settings: SweepSettings) -> list[Task]:
    """One task a level, with all its runs."""
    noise_on, runs, seed = settings.noise_on.value, request.runs, request.seed
    asked = {"noise_on": noise_on, "runs": runs, "seed": seed}
    levels = range(1, settings.largest + 1)
    return [{"key": f"{noise_on}-{runs}-{seed}-{level}", "level": level} | asked for level in levels]


def _sweep(done: Swept) -> NoiseSweep:
    return noise_sweep.gathered(_made(done.rows))


def sweep_table(done: Swept) -> list[Table]:
    """The first and the last level."""
    levels = sorted({1, done.settings.largest})
    return [experiment_tables.sweep_table(_sweep(done).rows, level) for level in levels]


def sweep_verdict(done: Swept) -> list[Check]:
    """What is asked of the sweep (Fig. 7)."""
    return _sweep_checks(_sweep(done), done.settings.noise_on, done.request.runs)


def _sweep_checks(sweep: NoiseSweep, noise_on: NoiseOn, runs: int) -> list[Check]:
    failed, gap = sum(r.failed for r in sweep.rows), sweep.dqcr_largest_difference
    limit = LARGEST_DQCR_DIFFERENCE
    checks = [
        Check("DQCR published against closed form", f"{gap:.1e}", f"≤ {limit:g}", gap <= limit),
        Check("runs that failed", str(failed), "0", failed == 0),
    ]
    eigenvalues = [r.least_eigenvalue for r in sweep.rows if r.least_eigenvalue is not None]
    if eigenvalues:
        least = min(eigenvalues)
        checks.append(Check("certificate, the worst run", f"{least:.1e}", "≥ -1e-9", least >= -1e-9))
    return checks if runs < _ENOUGH else [*checks, *_checks_by_bound(sweep, noise_on, runs)]


def _checks_by_bound(sweep: NoiseSweep, noise_on: NoiseOn, runs: int) -> list[Check]:
    """The best method against the Cramér-Rao bound, its own covariance and DQCR."""
    best = Method.MAXIMUM_LIKELIHOOD if noise_on is NoiseOn.CAMERA_MOTIONS else Method.ROBUST
    mine = [r for r in sweep.rows if r.method == best.value]
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
        dqcr = {r.level: r.rotation_deg for r in sweep.rows if r.method == Method.DQCR.value}
        ratio = min(dqcr[r.level] / r.rotation_deg for r in mine)
        checks.append(Check("times below DQCR in rotation", f"{ratio:.2f}", "≥ 5", ratio >= 5.0))
    return checks


NOISE_SWEEP = Experiment(
    name="hua-fig7",
    title="Error of X against the noise level, every method, with the Cramér-Rao bound.",
    settings=SweepSettings,
    row=NestedRow,
    tasks=sweep_tasks,
    run=noise_sweep.level_of,
    table=sweep_table,
    verdict=sweep_verdict,
    plot=lambda done: {"hua-fig7": experiment_plots.sweep_plot(_sweep(done).rows)},
    figures=lambda done: _sweep(done)._asdict(),
    runs=200,
    world="poses of the paper's Table 1",
    eyes="none: poses with noise",
    configured=False,
)


class LocalisationSettings(NamedTuple):
    """How often each target is located."""

    repetitions: Annotated[int, typer.Option(min=1, help="Localisations of each task.")] = 50


Located = Finished[LocalisationSettings, NestedRow]


def localisation_tasks(request: CampaignRequest, settings: LocalisationSettings) -> list[Task]:
    """One task a calibration."""
    seed, repetitions = request.seed, settings.repetitions
    asked = {"repetitions": repetitions, "seed": seed}
    return [{"key": f"{seed}-{repetitions}-{run}", "run": run} | asked for run in range(request.runs)]


def _localised(done: Located) -> list[LocalisationRow]:
    return list(localisation.rows_of([localisation.entries_of(row) for row in _made(done.rows)]))


def localisation_verdict(done: Located) -> list[Check]:
    """The robust solver, bad samples included, locates better than the paper's best (Fig. 5, 6)."""
    everything = {(r.method, r.samples): r for r in _localised(done) if r.task == "all"}
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


LOCALISATION = Experiment(
    name="hua-fig5",
    title="Localisation of knob, switch and key hole with every method.",
    settings=LocalisationSettings,
    row=NestedRow,
    tasks=localisation_tasks,
    run=localisation.calibration_row,
    table=lambda done: [experiment_tables.localisation_table(_localised(done))],
    verdict=localisation_verdict,
    plot=lambda done: {"hua-fig5": experiment_plots.localisation_plot(_localised(done))},
    figures=lambda done: {"rows": _localised(done)},
    runs=50,
    world="poses of the paper's Table 1, with 5 bad samples of 17",
    eyes="none: poses with noise",
    configured=False,
)


class IntrinsicsSettings(NamedTuple):
    """How many pictures."""

    views: Annotated[int, typer.Option(min=3, help="Pictures of each.")] = 15


Calibrated = Finished[IntrinsicsSettings, NestedRow]


def intrinsics_tasks(request: CampaignRequest, settings: IntrinsicsSettings) -> list[Task]:
    """One task a calibration."""
    seed, views = request.seed, settings.views
    return [
        {"key": f"{seed}-{views}-{run}", "run": run, "views": views, "seed": seed}
        for run in range(request.runs)
    ]


def _intrinsics(done: Calibrated) -> list[IntrinsicsRow]:
    """The emulated camera, and OpenCV's real one where its pictures are."""
    rows = intrinsics_experiment.rows_of(_made(done.rows))
    try:
        return rows + list(real_data.checkerboards())
    except RequestRefused as error:
        out.print(f"real pictures left out: {error}", style="yellow", highlight=False)
        return rows


def intrinsics_verdict(done: Calibrated) -> list[Check]:
    """Zhang's method finds the emulated camera and, where its pictures are, the real one."""
    rows = _intrinsics(done)
    boards = [
        abs(r.fx_error_percent) for r in rows if r.fx_error_percent is not None and r.detector != "charuco"
    ]
    checks = [
        Check("fx of the emulated camera, off by", f"{max(boards):.3f} %", "≤ 0.3 %", max(boards) <= 0.3)
    ]
    for real in rows:
        if real.pictures.startswith("OpenCV") and real.detector == "classic":
            off = 100.0 * (real.fx_px / real_data.OPENCV_FX_PX - 1.0)
            checks.append(
                Check("fx of the real pictures, off OpenCV's by", f"{off:+.3f} %", "≤ 0.3 %", abs(off) <= 0.3)
            )
    return checks


INTRINSICS = Experiment(
    name="hua-intrinsics",
    title="Zhang's method on the paper's camera, emulated, and on OpenCV's real pictures.",
    settings=IntrinsicsSettings,
    row=NestedRow,
    tasks=intrinsics_tasks,
    run=intrinsics_experiment.calibration_row,
    table=lambda done: [experiment_tables.intrinsics_table(_intrinsics(done))],
    verdict=intrinsics_verdict,
    plot=lambda done: {"hua-intrinsics": experiment_plots.intrinsics_plot(_made(done.rows)[0]["maps"])},
    figures=lambda done: {"rows": _intrinsics(done)},
    runs=2,
    world="the paper's camera and boards",
    eyes="rendered pictures",
    configured=False,
)


Stressed = Finished[NoSettings, NestedRow]
_TRIALS = (stress.BAD_SAMPLES, stress.SMALL_ROTATIONS)


def stress_tasks(request: CampaignRequest, settings: NoSettings) -> list[Task]:
    """One task for each block of runs of either scenario."""
    return [
        {"key": f"{trial.name}-{request.seed}-{first}-{count}", "trial": trial.name, "seed": request.seed,
         "first": first, "count": count}
        for trial in _TRIALS
        for first, count in _blocks(request.runs)
    ]  # fmt: skip


def _blocks(runs: int, size: int = 25) -> list[tuple[int, int]]:
    """First run and count of each block of at most ``size`` runs."""
    return [(first, min(size, runs - first)) for first in range(0, runs, size)]


def _stressed(done: Stressed) -> list[tuple[StressRow, ...]]:
    made = _made(done.rows)
    return [tuple(stress.rows_of(trial, made)) for trial in _TRIALS]


def stress_verdict(done: Stressed) -> list[Check]:
    """Bad samples and small rotations leave the robust solver usable, and no method improper."""
    bad, small = _stressed(done)
    among_bad, turning_little = (
        next(r for r in rows if r.method == Method.ROBUST.value) for rows in (bad, small)
    )
    improper = sum(r.improper for r in (*bad, *small))
    judged = done.request.runs >= _ENOUGH  # with fewer, chance decides
    small_mm = turning_little.translation_rms_mm
    bound = f"small rotations (Cramér-Rao bound {turning_little.bound_translation_mm:.2f}): rms"
    return [
        Check(
            f"NaN or left-handed, by any method in 2 × {done.request.runs} runs",
            f"{improper}",
            "0",
            improper == 0,
        ),
        _at_most("bad samples: median", among_bad.rotation_median_deg, 0.1, "°"),
        _at_most("bad samples: median", among_bad.translation_median_mm, 3.0, "mm"),
        Check(
            bound,
            f"{small_mm:.4g} mm",
            f"≤ 7 mm, from {_ENOUGH} runs on",
            small_mm <= 7.0 if judged else None,
        ),
    ]


STRESS = Experiment(
    name="hand-eye-stress",
    title="Two bad samples of fifteen, and rotations under 5°, with every method.",
    settings=NoSettings,
    row=NestedRow,
    tasks=stress_tasks,
    run=stress.block_row,
    table=lambda done: [experiment_tables.stress_table(rows) for rows in _stressed(done)],
    verdict=stress_verdict,
    figures=lambda done: {"rows": [r for rows in _stressed(done) for r in rows]},
    runs=200,
    world="drawn hand-eye problems",
    eyes="none: poses with noise",
    configured=False,
)


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
        Check("moveit off the published translation", f"{off:.2f} mm = {share:.2f} %", "≤ 1 %", share <= 1.0),
        Check("ethz_arm_sim hold-out", f"{ethz.hold_out_mm:.3f} mm", "≤ 1.6 mm", ethz.hold_out_mm <= 1.6),
    ]
    checks += [check for data in robust for check in _against_classical(data, rows)]
    show_checks(checks)
    passed = all(check.met for check in checks)
    write_json(json_file, {"rows": rows, "checks": checks, "passed": passed})
    return passed


def _against_classical(data: str, rows: Sequence[HoldOutRow]) -> list[Check]:
    """The robust solver's hold-out errors over those of the best classical method, each for itself."""
    of = {row.method: row for row in rows if row.data == data and row.error is None}
    classical = [of[method.value] for method in CLASSICAL if method.value in of]
    mine = of[Method.ROBUST.value]
    mm = mine.hold_out_mm / min(row.hold_out_mm for row in classical)
    deg = mine.hold_out_deg / min(row.hold_out_deg for row in classical)
    return [
        Check(f"{data} robust over best classical, {unit}", f"{ratio:.3f}", f"≤ {_BEHIND}", ratio <= _BEHIND)
        for unit, ratio in (("mm", mm), ("deg", deg))
    ]


def _at_most(what: str, value: float, limit: float, unit: str) -> Check:
    return Check(what, f"{value:.4g} {unit}", f"≤ {limit:g} {unit}", value <= limit)
