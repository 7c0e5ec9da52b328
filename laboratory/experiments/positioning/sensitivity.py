"""`longreach experiment sensitivity`: which source of error limits where the tool ends, by Sobol indices."""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, seeds
from laboratory.campaigns.rows import UNKNOWN, XYZ
from laboratory.experiments.positioning.corrected_run import driven, operate
from laboratory.experiments.positioning.mixed_worlds import Limited, Runs, limited, mixed_rig, sources_of
from laboratory.experiments.positioning.worlds import WORLDS, WorldName
from testbed.reporting.console import out, table

_RUN_S = 10.0  # [M] processor time of one run, for what is told before
_LEAST = 4  # samples, below which no interval is told


class DriveKind(StrEnum):
    """What brings the tool to the object."""

    ONE_LOOK = "one-look"
    OPEN_LOOP = "open-loop"


class SensitivitySettings(NamedTuple):
    """Which machines are drawn, and what is done with them."""

    world: Annotated[WorldName, typer.Option(help="What differs from one machine to the next.")] = (
        WorldName.LAB
    )
    arm: Annotated[
        str | None, typer.Option(help="Of CONFIG_DIR/arms, or a directory; in place of the world's own.")
    ] = None
    drive: Annotated[
        DriveKind, typer.Option(help="one-look: corrected on the way; open-loop: one step, uncorrected.")
    ] = DriveKind.ONE_LOOK

    @property
    def chosen_arm(self) -> str:
        """The arm that is driven."""
        return self.arm or WORLDS[self.world].arm


class SensitivityRow(NamedTuple):
    """One run: the true error at its end, camera axes. ``source``: what is another's; A, B: none, all."""

    seed: int
    source: str
    true_mm: XYZ = UNKNOWN
    failure: str = ""
    cpu_s: float = float("nan")


Varied = Finished[SensitivitySettings, SensitivityRow]


def sensitivity_tasks(request: CampaignRequest, settings: SensitivitySettings) -> list[Task]:
    """For each seed a run of A, of B, and one for each source. Tells what that costs."""
    sources = sources_of(request.config_dir, settings.world, settings.chosen_arm, request.seed)
    asked = {name: str(value) for name, value in settings._asdict().items()} | {"arm": settings.chosen_arm}
    tasks = [
        {"key": f"{source}-{seed}", "seed": seed, "source": source} | asked
        for seed in seeds(request)
        for source in ("A", "B", *sources)
    ]
    cost = f"{request.runs} samples of {len(sources) + 2} runs: {len(tasks)} runs, about"
    hours = len(tasks) * _RUN_S / 3600.0
    out.print(f"{cost} {hours:.1f} h of one core", style="dim", highlight=False)
    return tasks


def one_mixed_run(config_dir: Path, task: Task) -> dict[str, Any]:
    """The row of one run: turned parallel, local track, one look and its drive."""
    row = {"seed": task["seed"], "source": task["source"]}
    rig = mixed_rig(config_dir, WorldName(task["world"]), task["arm"], task["seed"], task["source"])
    rig.command("enable")
    operate(rig, "orientation-adjustment", {})
    operate(rig, "local-track", {})
    branch = driven(rig, {} if task["drive"] == DriveKind.ONE_LOOK else {"corrections": 0})
    return row | {"true_mm": branch.true_mm, "failure": branch.failure}


def runs_of(rows: Sequence[SensitivityRow]) -> tuple[tuple[str, ...], Runs]:
    """The sources, and true x and y (m = 2) of every sample, NaN where a run failed."""
    found = {(row.source, row.seed): (row.true_mm.x, row.true_mm.y) for row in rows}
    names = tuple(dict.fromkeys(source for source, _ in found if source not in ("A", "B")))
    numbers = list(dict.fromkeys(seed for _, seed in found))

    def results(source: str) -> Any:
        return np.array([found[source, seed] for seed in numbers], dtype=np.float64).reshape(-1, 2)

    return names, Runs(results("A"), results("B"), np.array([results(name) for name in names]))


def found_in(done: Varied) -> tuple[tuple[str, ...], Runs, Limited | None]:
    """The sources, the samples that are whole, and their indices, where these are enough."""
    names, runs = runs_of(done.rows)
    whole = runs.whole()
    return names, whole, limited(whole, done.request.seed) if len(whole.A) >= _LEAST else None


def sensitivity_table(done: Varied) -> list[Table]:
    """A line a source, the greatest first."""
    names, whole, found = found_in(done)
    if found is None:
        return []
    indices, cells = found.indices, []
    for i in np.argsort(-indices.total):
        share_mm = np.sqrt(max(indices.total[i], 0.0) * indices.variance)
        alone, together = (
            f"{value:.2f} ({ends[0]:.2f} to {ends[1]:.2f})"
            for value, ends in (
                (indices.first[i], found.first_ends[:, i]),
                (indices.total[i], found.total_ends[:, i]),
            )
        )
        cells.append((names[i], together, alone, f"{share_mm:.2f}", f"{found.greatest[i]:.0%}"))
    headings = ("source of error", "total (95 %)", "alone (95 %)", "makes, mm", "is the greatest")
    title = f"share of the variance of true x and y after {done.settings.drive}, {len(whole.A)} samples"
    return [table(title, headings, cells)]


def sensitivity_verdict(done: Varied) -> list[Check]:
    """For information: how large the error is, and how much of it varies from machine to machine."""
    _, runs = runs_of(done.rows)
    names, whole, found = found_in(done)
    left_out = len(runs.A) - len(whole.A)
    if found is None:
        wanted = f"≥ {_LEAST}"
        return [Check("samples without a failed run", f"{len(whole.A)} of {len(runs.A)}", wanted, False)]
    ends = np.concatenate([whole.A, whole.B])
    top = int(np.argmax(found.indices.total))
    sure = found.greatest[top] >= 0.95
    return [
        Check("samples left out for a failed run", f"{left_out} of {len(runs.A)}", "", None),
        Check(
            "x and y together, root of the mean square", _mm(np.sqrt((ends**2).sum(axis=1).mean())), "", None
        ),
        Check("that all machines have in common", _mm(np.linalg.norm(ends.mean(axis=0))), "", None),
        Check("that differs from machine to machine", _mm(np.sqrt(found.indices.variance)), "", None),
        Check("shares of the sources alone, together", f"{found.indices.first.sum():.2f}", "", None),
        Check("limited by", names[top] if sure else f"not told apart: {_rivals(names, found)}", "", None),
    ]


def _mm(value: Any) -> str:
    return f"{float(value):.2f} mm"


def _rivals(names: Sequence[str], found: Limited) -> str:
    """The fewest sources of which one is the greatest, with 95 %."""
    order = np.argsort(-found.greatest)
    enough = int(np.searchsorted(np.cumsum(found.greatest[order]), 0.95)) + 1
    return " or ".join(names[i] for i in order[:enough])


def sensitivity_figures(done: Varied) -> Mapping[str, Any]:
    """The indices with their intervals."""
    names, whole, found = found_in(done)
    if found is None:
        return {"samples": len(whole.A), "sources": {}}
    indices = found.indices
    return {
        "samples": len(whole.A),
        "variance_mm2": indices.variance,
        "sources": {
            name: {
                "total": indices.total[i],
                "total_95": found.total_ends[:, i].tolist(),
                "alone": indices.first[i],
                "alone_95": found.first_ends[:, i].tolist(),
                "greatest": found.greatest[i],
            }
            for i, name in enumerate(names)
        },
    }


SENSITIVITY = Experiment(
    name="sensitivity",
    title="Which source of error limits where the tool ends.",
    settings=SensitivitySettings,
    row=SensitivityRow,
    tasks=sensitivity_tasks,
    run=one_mixed_run,
    table=sensitivity_table,
    verdict=sensitivity_verdict,
    figures=sensitivity_figures,
    runs=64,
    eyes="model",
)
