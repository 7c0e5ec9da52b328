"""`longreach experiment hand-eye --method guided`: guided sessions over many drawn worlds."""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.table import Table
from scipy.stats import chi2

from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, seeds
from laboratory.experiments.hand_eye.guided_experiment import (
    LIMIT_MM,
    LOCATING,
    TARGETS,
    one_run,
    word_of,
)
from testbed.reporting.console import table
from testbed.scenarios.scenario import chosen_overrides, load_settings
from vision_pc.config.choices import Method

_PAPER_MM = 2.9  # Hua et al. 2024, Fig. 5: DQCR


class GuidedCampaignSettings(NamedTuple):
    """What the worlds are drawn from, and what is done in each."""

    repetitions: Annotated[
        int, typer.Option(min=0, help="Poses from which the targets are located; 0: none.")
    ] = 50
    against_random: Annotated[bool, typer.Option(help="Also take samples at random poses.")] = True
    scenario: Annotated[str, typer.Option(help="What the worlds are drawn from.")] = "hand_eye"


class GuidedRow(NamedTuple):
    """One session: error of X, its covariances, proof; ``curves`` and ``targets`` hold the other columns."""

    key: str
    seed: int
    error_mm: float
    error_deg: float
    std_mm: float
    std_deg: float
    std_arm_mm: float
    std_arm_deg: float
    nees: float
    nees_arm: float
    left_out: int
    certified: bool
    guided_refused: int
    faults: int
    guided_needed: int | None
    random_needed: int | None
    located: int | None
    curves: dict[str, float | None] | None
    targets: dict[str, float] | None
    failure: str
    run_s: float
    cpu_s: float

    def after(self, kind: str, samples: int) -> float | None:
        """Error of X (mm) of the guided or random session after so many samples; None: no answer."""
        return (self.curves or {}).get(f"{kind}_{samples}_mm")


Guided = Finished[GuidedCampaignSettings, GuidedRow]


def guided_tasks(request: CampaignRequest, settings: GuidedCampaignSettings) -> list[Task]:
    """One task a world. Raises ConfigurationError when the first one's configuration is wrong."""
    overrides = chosen_overrides(request.config_dir, settings.scenario, request.seed, [])
    load_settings(request.config_dir, overrides)
    asked = {
        "scenario": settings.scenario,
        "repetitions": settings.repetitions,
        "random": settings.against_random,
    }
    return [{"key": f"seed-{seed}", "seed": seed} | asked for seed in seeds(request)]


def guided_table(done: Guided) -> list[Table]:
    """Sessions, samples needed, located targets."""
    rows = _successful_rows(done)
    if not rows:
        return []
    targets = [_targets(rows)] if rows[0].targets else []
    return [_sessions(rows), _samples_needed(rows, done.settings.against_random), *targets]


def guided_verdict(done: Guided) -> list[Check]:
    """Every session was solved with proof, and located the targets as well as the paper's best."""
    rows, runs = _successful_rows(done), len(done.rows)
    checks = [Check("sessions that ended with an answer", f"{len(rows)} of {runs}", "all", len(rows) == runs)]
    return checks + (_checks(rows, done.settings.against_random) if rows else [])


def _successful_rows(done: Guided) -> list[GuidedRow]:
    return [row for row in done.rows if not row.failure]


def _sessions(rows: list[GuidedRow]) -> Any:
    columns = ("seed", "error mm", "error °", "± mm", "± °", "± mm with arm", "± ° with arm", "NEES",
               "NEES with arm", "left out", "refused poses", "faults", "s")  # fmt: skip
    keys = ("error_mm", "error_deg", "std_mm", "std_deg", "std_arm_mm", "std_arm_deg", "nees", "nees_arm")
    digits = (2, 3, 2, 3, 2, 3, 1, 1)
    cells = [
        (
            row.seed,
            *(f"{getattr(row, key):.{n}f}" for key, n in zip(keys, digits, strict=True)),
            row.left_out,
            row.guided_refused,
            row.faults,
            f"{row.run_s:.0f}",
        )
        for row in rows
    ]
    medians = (
        f"{np.median([getattr(row, key) for row in rows]):.{n}f}" for key, n in zip(keys, digits, strict=True)
    )
    return table("guided sessions: true error of X", columns, [*cells, ("median", *medians, "", "", "", "")])


def _samples_needed(rows: list[GuidedRow], against_random: bool) -> Any:
    """Samples needed to come under the limit and stay there, guided and random."""
    cells = []
    for kind in ("guided", "random") if against_random else ("guided",):
        reached = [int(c) for row in rows if (c := getattr(row, f"{kind}_needed")) is not None]
        spread = f"{np.median(reached):.0f} ({min(reached)} … {max(reached)})" if reached else "–"
        after = [f"{_median([row.after(kind, n) for row in rows]):.2f}" for n in (4, 5, 6, 8, 12, 17)]
        cells.append((kind, f"{len(reached)} of {len(rows)}", spread, *after))
    columns = ("poses", f"under {LIMIT_MM:.0f} mm", "needed: median (least … most)",
               *(f"mm after {n}" for n in (4, 5, 6, 8, 12, 17)))  # fmt: skip
    return table("samples needed: the error of X stays under the limit from there on", columns, cells)


def _median(values: Sequence[float | None]) -> float:
    """The median where None counts as never."""
    return float(np.median([np.inf if v is None else float(v) for v in values]))


def _targets(rows: list[GuidedRow]) -> Any:
    cells = []
    for method in LOCATING:
        means = [_of(rows, f"{word_of(name)}_{method.value}_mm") for name in TARGETS]
        cells.append((f"in the hand, {method.value}", *(f"{m.mean():.2f} ± {m.std():.2f}" for m in means)))
    spreads = [_of(rows, f"{word_of(name)}_spread_mm") for name in TARGETS]
    cells.append(("spread over poses", *(f"{s.mean():.2f}" for s in spreads)))
    shares = [_of(rows, f"{word_of(name)}_within_percent") for name in TARGETS]
    cells.append((f"within {LIMIT_MM:.0f} mm, %", *(f"{s.mean():.0f}" for s in shares)))
    bases = [_of(rows, f"{word_of(name)}_base_mm") for name in TARGETS]
    cells.append(
        ("in the base, the arm's own error included", *(f"{b.mean():.1f} ± {b.std():.1f}" for b in bases))
    )
    located = sum(row.located or 0 for row in rows)
    return table(f"error of located targets, mm ({located} poses)", ("", *TARGETS), cells)


def _of(rows: list[GuidedRow], key: str) -> NDArray[np.float64]:
    """A column of the located targets."""
    return np.array([float(row.targets[key]) for row in rows if row.targets and key in row.targets])


def _checks(rows: list[GuidedRow], against_random: bool) -> list[Check]:
    proven = sum(row.certified for row in rows)
    error = float(np.median([row.error_mm for row in rows]))
    band = _nees_band(len(rows))
    mean = float(np.mean([row.nees_arm for row in rows]))
    checks = [
        Check("global optimum proven", f"{proven} of {len(rows)}", "all", proven == len(rows)),
        Check("median true error of X", f"{error:.2f} mm", f"≤ {LIMIT_MM:g} mm", error <= LIMIT_MM),
        Check(
            f"mean NEES with arm and camera, 6 ideal; 95 % of honest campaigns of {len(rows)}",
            f"{mean:.1f}",
            f"{band[0]:.1f} … {band[1]:.1f}",
            band[0] <= mean <= band[1],
        ),
    ]
    if against_random:
        guided, anyhow = (
            _median([getattr(row, f"{kind}_needed") for row in rows]) for kind in ("guided", "random")
        )
        told = ["never" if np.isinf(n) else f"{n:.0f}" for n in (guided, anyhow)]
        what = "samples needed at guided poses, median, against random ones"
        checks.append(Check(what, told[0], f"≤ {told[1]}", guided <= anyhow))
    if rows[0].targets:
        keys = [f"{word_of(name)}_{Method.ROBUST.value}_mm" for name in TARGETS]
        mean = float(np.mean([_of(rows, key).mean() for key in keys]))
        what = "targets in the hand, mean error, against the paper's DQCR"
        checks.append(Check(what, f"{mean:.2f} mm", f"≤ {_PAPER_MM} mm", mean <= _PAPER_MM))
    return checks


def _nees_band(runs: int) -> tuple[float, float]:
    """Where the mean of ``runs`` squared errors of six honest components lies in 95 % of campaigns."""
    low, high = (float(chi2.ppf(q, 6 * runs)) / runs for q in (0.025, 0.975))
    return low, high


def guided_plot(done: Guided) -> dict[str, Figure]:
    """Error of X over samples, and errors of the located targets."""
    rows = _successful_rows(done)
    if not rows:
        return {}
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    counts = np.arange(3, 18)
    for kind, colour in (("guided", "tab:blue"), ("random", "tab:orange")):
        curves = np.array([[row.after(kind, int(n)) for n in counts] for row in rows], dtype=float)
        if np.isnan(curves).all():
            continue
        low, middle, high = np.nanquantile(curves, (0.1, 0.5, 0.9), axis=0)
        left.plot(counts, middle, color=colour, label=f"{kind} poses: median, 10 to 90 %")
        left.fill_between(counts, low, high, color=colour, alpha=0.2)
    left.axhline(LIMIT_MM, color="grey", linestyle=":", label=f"{LIMIT_MM:.0f} mm")
    left.set(xlabel="samples", ylabel="true error of X, mm", ylim=(0.0, 12.0))
    left.legend()
    if rows[0].targets:
        width = 0.15
        for k, method in enumerate(LOCATING):
            means = [_of(rows, f"{word_of(name)}_{method.value}_mm") for name in TARGETS]
            places = np.arange(len(TARGETS)) + (k - 2) * width
            right.bar(
                places, [m.mean() for m in means], width, yerr=[m.std() for m in means], label=method.value
            )
        right.axhline(_PAPER_MM, color="grey", linestyle=":", label="paper, DQCR")
        right.set_xticks(range(len(TARGETS)), TARGETS)
        right.set(ylabel="error in the hand, mm")
        right.set_ylim(top=1.35 * right.get_ylim()[1])
        right.legend(fontsize=8, ncol=3, loc="upper center")
    figure.suptitle(f"{len(rows)} guided sessions on the emulated arm")
    return {"hand-eye-guided": figure}


GUIDED = Experiment(
    name="hand-eye-guided",
    title="Guided hand-eye sessions on the emulated arm.",
    settings=GuidedCampaignSettings,
    row=GuidedRow,
    tasks=guided_tasks,
    run=one_run,
    table=guided_table,
    verdict=guided_verdict,
    plot=guided_plot,
    runs=10,
    seed=301,
    eyes="rendered pictures",
)
