"""Many demonstrations in lockstep: how many end under 10 and under 5 mm, after one look and after more."""

import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from foundation.configuration import merged, parse_overrides
from testbed.campaigns.campaign import run_campaign
from testbed.demonstration.lockstep import run_lockstep
from testbed.reporting import outcome as outcomes
from testbed.reporting.console import bars, out, table, write_json
from testbed.reporting.outcome import Outcome
from testbed.reporting.presentation import Choice
from testbed.scenarios.scenario import load_scenario
from testbed.scenarios.settings import load_settings

LIMITS_MM = (10.0, 5.0)
WANTED_SHARE = 0.9  # of the runs, under LIMITS_MM[0] after the last look: 18 of 20


def row_of(outcome: Outcome, world: dict[str, Any]) -> dict[str, Any]:
    """One run as a flat row: what was drawn, true errors after each look, and what stopped it."""
    row: dict[str, Any] = {"seed": outcome.seed}
    row["payload_kg"] = world.get("plant", {}).get("payload", {}).get("mass_kg", float("nan"))
    mount = world.get("scene", {}).get("mount", {}).get("rotation_deg", (0.0, 0.0, 0.0))
    row["mount_deg"] = float(np.linalg.norm(mount))
    for number in range(1, outcome.looks + 1):
        stage = outcome.after_look(number)
        p_mm = np.full(3, np.nan) if stage is None else 1e3 * stage.true.p_m
        image_mm = np.full(3, np.nan) if stage is None or stage.image is None else 1e3 * stage.image.p_m
        for axis, true, seen in zip("xyz", p_mm, image_mm, strict=True):
            row[f"look{number}_true_{axis}_mm"] = float(true)
            row[f"look{number}_image_{axis}_mm"] = float(seen)
        row[f"look{number}_worst_mm"] = float(np.abs(p_mm[:2]).max())
    row["failure"] = outcome.details.get("failure", "")
    row["simulated_s"] = outcome.simulated_s
    row["wall_s"] = outcome.wall_s
    row["event_log_sha256"] = outcome.details["event_log_sha256"]
    return row


def one_run(config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """The row of one seeded demonstration; ``task`` names its scenario, seed, looks and assignments."""
    scenario, seed = task["scenario"], task["seed"]
    world = merged(load_scenario(config_dir, scenario).world(seed), parse_overrides(task["assignments"]))
    with bars(quiet=True) as shown:
        done = run_lockstep(config_dir, world, Choice(scenario, seed, task["looks"]), shown)
    return row_of(done.outcome, world)


def _number(row: dict[str, Any], column: str) -> float:
    """The figure, NaN where the run did not get there."""
    value = row.get(column)
    return float("nan") if value is None else float(value)


def counts(rows: list[dict[str, Any]], looks: int) -> list[dict[str, Any]]:
    """For each number of looks, how many runs ended with true x and y under each limit; a failure is none."""
    table_rows = []
    for number in range(1, looks + 1):
        worst = np.array([_number(row, f"look{number}_worst_mm") for row in rows])
        made: dict[str, Any] = {"looks": number, "runs": len(rows)}
        for limit in LIMITS_MM:
            made[f"under_{limit:.0f}_mm"] = int(np.count_nonzero(worst < limit))
        finite = worst[np.isfinite(worst)]
        made["median_mm"] = float(np.median(finite)) if len(finite) else float("nan")
        made["p95_mm"] = float(np.percentile(finite, 95)) if len(finite) else float("nan")
        made["not_reached"] = int(np.count_nonzero(~np.isfinite(worst)))
        table_rows.append(made)
    return table_rows


def run_experiment(
    config_dir: Path,
    scenario: str,
    first_seed: int,
    runs: int,
    looks: int,
    assignments: list[str],
    directory: Path,
    scheduler: str | None,
    json_file: Path | None,
) -> bool:
    """Whether enough runs ended under the first limit after the last look; rows go to CSV and JSON."""
    world = load_scenario(config_dir, scenario).world(first_seed)
    load_settings(config_dir, merged(world, parse_overrides(assignments)))  # what is wrong is told at once
    began = time.perf_counter()
    asked = {"scenario": scenario, "looks": looks, "assignments": assignments}
    tasks = [{"key": f"seed-{seed}", "seed": seed} | asked for seed in range(first_seed, first_seed + runs)]
    rows = run_campaign(
        directory,
        partial(one_run, config_dir),
        tasks,
        scheduler=scheduler,
        title=f"{runs} demonstrations in lockstep",
    )
    rows = [row | {"seed": task["seed"]} for row, task in zip(rows, tasks, strict=True)]
    counted = counts(rows, looks)
    _show(rows, counted, looks)
    figures = {
        "scenario": scenario,
        "limit_mm": 1e3 * outcomes.LIMIT_M,
        "counts": counted,
        "rows": rows,
        "wall_s": time.perf_counter() - began,
    }
    write_json(directory / "lockstep-demo.json", figures)
    write_json(json_file, figures)
    out.print(f"rows written to {directory / 'rows.csv'}", style="dim", highlight=False, soft_wrap=True)
    return bool(counted[-1][f"under_{LIMITS_MM[0]:.0f}_mm"] >= WANTED_SHARE * runs)


def _show(rows: list[dict[str, Any]], counted: list[dict[str, Any]], looks: int) -> None:
    headings = ["seed", "payload kg", "mount °"]
    headings += [f"look {number} {axis}" for number in range(1, looks + 1) for axis in "xyz"]
    shown = [
        [
            row["seed"],
            f"{_number(row, 'payload_kg'):.0f}",
            f"{_number(row, 'mount_deg'):.1f}",
            *(
                f"{_number(row, f'look{number}_true_{axis}_mm'):+.1f}"
                for number in range(1, looks + 1)
                for axis in "xyz"
            ),
            row["failure"] or "",
        ]
        for row in rows
    ]
    out.print(table("true errors, mm, camera axes", [*headings, "stopped by"], shown))
    limits = [f"under {limit:.0f} mm" for limit in LIMITS_MM]
    columns = ["looks", *limits, "of", "median mm", "95 % mm", "not reached"]
    cells = [
        [
            made["looks"],
            *(made[f"under_{limit:.0f}_mm"] for limit in LIMITS_MM),
            made["runs"],
            f"{made['median_mm']:.2f}",
            f"{made['p95_mm']:.2f}",
            made["not_reached"],
        ]
        for made in counted
    ]
    out.print(table("worse of |x| and |y|, true", columns, cells))
