"""Many cuts of the reference stream at random moments of streamed motions, in lockstep, without pictures."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from testbed.campaigns.campaign import run_campaign
from testbed.experiments.robustness.stream_cut_run import COMMAND_MS, CUTS, FLOW_MS, RATES_HZ, one_cut
from testbed.reporting.console import out, table, write_json
from testbed.scenarios.settings import chosen_overrides, load_settings


def one_run(config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """The row of one seeded cut, in the world of its scenario and seed."""
    overrides = chosen_overrides(config_dir, task["scenario"], task["seed"], task["assignments"])
    return one_cut(load_settings(config_dir, overrides), task["seed"])


def run_experiment(
    config_dir: Path,
    scenario: str,
    first_seed: int,
    runs: int,
    assignments: list[str],
    directory: Path,
    scheduler: str | None,
    json_file: Path | None,
) -> bool:
    """Whether no run kept a valve command or the oil going for too long; prints the distribution."""
    tasks = [
        {"key": f"{seed}", "scenario": scenario, "seed": seed, "assignments": assignments}
        for seed in range(first_seed, first_seed + runs)
    ]
    function = partial(one_run, config_dir)
    rows = run_campaign(directory, function, tasks, scheduler=scheduler, title="cuts of the reference stream")
    lines: list[tuple[object, ...]] = [("limit", "", "", "", "", COMMAND_MS, "", "", FLOW_MS, 0, 0, "")]
    groups: list[tuple[str, list[dict[str, Any]]]] = [
        *((f"{rate:g} Hz", [row for row in rows if row.get("rate_hz") == rate]) for rate in RATES_HZ),
        *((f"{cut} cut", [row for row in rows if row.get("cut") == cut]) for cut in CUTS),
        ("all", list(rows)),
    ]
    lines += [_line(name, group) for name, group in groups if group]
    columns = (
        "", "runs", "speed, m/s",
        "command: p50", "p95", "max",
        "flow: p50", "p95", "max",
        "resumed", "failed", "verdict",
    )  # fmt: skip
    title = (
        "last fresh reference → last valve command that is not neutral, and → zero flow, "
        f"ms (seeds {first_seed}…{first_seed + runs - 1})"
    )
    out.print(table(title, columns, lines))
    for row in rows:
        if not _passed(row):
            out.print(f"FAIL {row}", highlight=False)
    write_json(
        json_file, {"first_seed": first_seed, "command_ms": COMMAND_MS, "flow_ms": FLOW_MS, "rows": rows}
    )
    return all(map(_passed, rows))


def _passed(row: dict[str, Any]) -> bool:
    return not row.get("failure") and str(row.get("pass")) == "True"


def _line(name: str, rows: Sequence[dict[str, Any]]) -> tuple[object, ...]:
    done = [row for row in rows if not row.get("failure")]
    cells: list[str] = []
    for column in ("command_ms", "flow_ms"):
        values = [float(row[column]) for row in done] or [float("nan")]
        cells += [f"{value:.1f}" for value in np.percentile(values, [50, 95, 100])]
    speeds = [float(row["speed_m_s"]) for row in done] or [float("nan")]
    resumed = sum(str(row["resumed"]) == "True" for row in done)
    failed = sum(not _passed(row) for row in rows)
    span = f"{min(speeds):.2f}…{max(speeds):.2f}"
    return name, len(rows), span, *cells, resumed, failed, "FAIL" if failed else "pass"
