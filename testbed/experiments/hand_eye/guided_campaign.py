"""`longreach experiment hand-eye-guided`: guided sessions over many drawn worlds."""

import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from testbed.campaigns.campaign import run_campaign
from testbed.experiments.hand_eye.check import Check, concluded
from testbed.experiments.hand_eye.guided_experiment import (
    LIMIT_MM,
    LOCATING,
    TARGETS,
    Choice,
    one_run,
    word_of,
)
from testbed.reporting.console import out, table
from testbed.scenarios.settings import chosen_overrides, load_settings
from vision_pc.core.hand_eye.solvers.methods import Method

Row = dict[str, Any]
_PAPER_MM = 2.9  # Hua et al. 2024, Fig. 5: DQCR


def run_guided(
    choice: Choice,
    runs: int,
    first_seed: int,
    directory: Path,
    scheduler: str | None,
    plot: Path | None,
    json_file: Path | None,
) -> bool:
    """Whether every session was solved with proof, and located the targets as well as the paper's best."""
    config_dir = Path(choice.config_dir)
    load_settings(config_dir, chosen_overrides(config_dir, choice.scenario, first_seed, []))
    began = time.perf_counter()
    asked = {"scenario": choice.scenario, "repetitions": choice.repetitions, "random": choice.against_random}
    tasks = [{"key": f"seed-{seed}", "seed": seed} | asked for seed in range(first_seed, first_seed + runs)]
    rows = run_campaign(
        directory, partial(one_run, choice), tasks, scheduler=scheduler, title=f"{runs} guided sessions"
    )
    rows = [row | {"seed": task["seed"]} for row, task in zip(rows, tasks, strict=True)]
    done = [row for row in rows if not row["failure"]]
    for row in rows:
        if row["failure"]:
            out.print(f"seed {row['seed']} failed: {row['failure']}", style="bold red", highlight=False)
    checks = [Check("sessions that ended with an answer", f"{len(done)} of {runs}", len(done) == runs)]
    if done:
        out.print(_sessions(done))
        out.print(_needed(done))
        checks += _checks(done)
        if "located" in done[0]:
            out.print(_targets(done))
        if plot is not None:
            draw(done, plot)
        spent = [float(row["run_s"]) for row in done]
        out.print(f"seconds a run: median {np.median(spent):.0f}, all {time.perf_counter() - began:.0f}")
    return concluded(checks, {"rows": rows}, json_file)


def _sessions(rows: list[Row]) -> Any:
    columns = ("seed", "error mm", "error °", "± mm", "± °", "± mm with arm", "± ° with arm", "NEES",
               "NEES with arm", "left out", "refused poses", "faults", "s")  # fmt: skip
    keys = ("error_mm", "error_deg", "std_mm", "std_deg", "std_arm_mm", "std_arm_deg", "nees", "nees_arm")
    digits = (2, 3, 2, 3, 2, 3, 1, 1)
    cells = [
        (
            row["seed"],
            *(f"{row[key]:.{n}f}" for key, n in zip(keys, digits, strict=True)),
            row["left_out"],
            row["guided_refused"],
            row["faults"],
            f"{row['run_s']:.0f}",
        )
        for row in rows
    ]
    medians = (f"{np.median([row[key] for row in rows]):.{n}f}" for key, n in zip(keys, digits, strict=True))
    return table("guided sessions: true error of X", columns, [*cells, ("median", *medians, "", "", "", "")])


def _needed(rows: list[Row]) -> Any:
    """Samples needed to come under the limit and stay there, guided and random."""
    cells = []
    for kind in ("guided", "random"):
        if f"{kind}_needed" not in rows[0]:
            continue
        counts = [row[f"{kind}_needed"] for row in rows]
        reached = [int(c) for c in counts if c is not None]
        spread = f"{np.median(reached):.0f} ({min(reached)} … {max(reached)})" if reached else "–"
        after = [f"{_median(rows, f'{kind}_{n}_mm'):.2f}" for n in (4, 5, 6, 8, 12, 17)]
        cells.append((kind, f"{len(reached)} of {len(rows)}", spread, *after))
    columns = ("poses", f"under {LIMIT_MM:.0f} mm", "needed: median (least … most)",
               *(f"mm after {n}" for n in (4, 5, 6, 8, 12, 17)))  # fmt: skip
    return table("samples needed: the error of X stays under the limit from there on", columns, cells)


def _median(rows: list[Row], key: str) -> float:
    values = [row.get(key) for row in rows]
    return float(np.median([np.inf if v is None else float(v) for v in values]))


def _targets(rows: list[Row]) -> Any:
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
    located = sum(int(row["located"]) for row in rows)
    return table(f"error of located targets, mm ({located} poses)", ("", *TARGETS), cells)


def _of(rows: list[Row], key: str) -> np.ndarray:
    return np.array([float(row[key]) for row in rows if row.get(key) is not None])


def _checks(rows: list[Row]) -> list[Check]:
    proven = sum(bool(row["certified"]) for row in rows)
    error = float(np.median(_of(rows, "error_mm")))
    band = _nees_band(len(rows))
    mean = float(np.mean(_of(rows, "nees_arm")))
    checks = [
        Check("global optimum proven", f"{proven} of {len(rows)}", proven == len(rows)),
        Check(f"median true error of X ≤ {LIMIT_MM:g} mm", f"{error:.2f} mm", error <= LIMIT_MM),
        Check(
            f"mean NEES with arm and camera, 6 ideal, 95 % of honest campaigns of {len(rows)} in "
            f"{band[0]:.1f} … {band[1]:.1f}",
            f"{mean:.1f}",
            band[0] <= mean <= band[1],
        ),
    ]
    if "random_needed" in rows[0]:
        guided, anyhow = _median(rows, "guided_needed"), _median(rows, "random_needed")
        told = ["never" if np.isinf(n) else f"{n:.0f}" for n in (guided, anyhow)]
        text = f"median {told[0]} against {told[1]}"
        checks.append(Check("guided needs no more samples than random poses", text, guided <= anyhow))
    if "located" in rows[0]:
        keys = [f"{word_of(name)}_{Method.ROBUST.value}_mm" for name in TARGETS]
        mean = float(np.mean([_of(rows, key).mean() for key in keys]))
        what = f"targets in the hand, mean error ≤ {_PAPER_MM} mm (the paper's DQCR)"
        checks.append(Check(what, f"{mean:.2f} mm", mean <= _PAPER_MM))
    return checks


def _nees_band(runs: int) -> tuple[float, float]:
    """Where the mean of ``runs`` squared errors of six honest components lies in 95 % of campaigns."""
    low, high = (float(chi2.ppf(q, 6 * runs)) / runs for q in (0.025, 0.975))
    return low, high


def draw(rows: list[Row], path: Path) -> None:
    """Write the figure to ``path``: error of X over samples, and errors of the located targets."""
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    counts = np.arange(3, 18)
    for kind, colour in (("guided", "tab:blue"), ("random", "tab:orange")):
        curves = np.array([[row.get(f"{kind}_{n}_mm") for n in counts] for row in rows], dtype=float)
        if np.isnan(curves).all():
            continue
        low, middle, high = np.nanquantile(curves, (0.1, 0.5, 0.9), axis=0)
        left.plot(counts, middle, color=colour, label=f"{kind} poses: median, 10 to 90 %")
        left.fill_between(counts, low, high, color=colour, alpha=0.2)
    left.axhline(LIMIT_MM, color="grey", linestyle=":", label=f"{LIMIT_MM:.0f} mm")
    left.set(xlabel="samples", ylabel="true error of X, mm", ylim=(0.0, 12.0))
    left.legend()
    if "located" in rows[0]:
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
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    out.print(f"figure written to {path}", style="dim", highlight=False, soft_wrap=True)
