"""`longreach experiment targets`: holes and clicked places of drawn walls, a pair each, against the truth."""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, at_least, at_most, inside, seeds
from laboratory.experiments.targets.one_target import REFUSING, ROWS, TargetRow, one_target
from testbed.reporting.console import table

_NORMAL_DEG = 1.5
_NEES = (0.8, 1.25)
_DETECTED, _FALSE = 0.99, 0.02
_SPREAD = ("lateral_mm", "depth_mm", "normal_deg")
_RATIOS = ("nees", "nees_lateral", "nees_depth", "nees_normal")


class TargetSceneSettings(NamedTuple):
    """Which rows of the table."""

    only: Annotated[list[str] | None, typer.Option(help="Only this row; repeatable.")] = None


Scenes = Finished[TargetSceneSettings, TargetRow]


def target_tasks(request: CampaignRequest, settings: TargetSceneSettings) -> list[Task]:
    """The same seeds in every row, those of one texture together.

    Raises BadParameter for a row that is not known.
    """
    if unknown := sorted(set(settings.only or ()) - set(ROWS)):
        raise typer.BadParameter(f"no row '{unknown[0]}'; known: {', '.join(ROWS)}")
    chosen = settings.only or list(ROWS)
    return [
        {"key": f"{name}-{seed}", "row": name, "seed": seed} for name in chosen for seed in seeds(request)
    ]


def target_table(done: Scenes) -> list[Table]:
    """Errors and what was told of them, as vision sees the wall and with a camera that is known.

    Nothing where only rows that must be refused were run: the verdict says it all.
    """
    heads = ["row", "scenes", "told", "across mm: median, 95 %", "along mm", "normal °"]
    heads += ["error² / variance told", "across", "along", "normal", "CPU ms"]
    rows = _rows(done)
    seen = {name: of for name, of in rows.items() if name not in REFUSING}
    if not seen:
        return []
    return [
        table("as vision sees it: the tool's marker tells of the camera", heads, _cells(seen, "seen")),
        table("the camera known: the measurement alone", heads, _cells(seen, "known")),
    ]


def _rows(done: Scenes) -> dict[str, list[TargetRow]]:
    found = {name: [row for row in done.rows if row.row == name and not row.failure] for name in ROWS}
    return {name: of for name, of in found.items() if of}


def _cells(rows: dict[str, list[TargetRow]], which: str) -> list[Sequence[Any]]:
    cells: list[Sequence[Any]] = []
    for name, of in rows.items():
        pairs = [_pair(_column(of, which, field)) for field in _SPREAD]
        ratios = [f"{_mean(_column(of, which, field)):.2f}" for field in _RATIOS]
        told = sum(not row.refused for row in of)
        ms = f"{np.median([row.measure_ms for row in of]):.0f}" if which == "seen" else ""
        cells.append([ROWS[name].words, len(of), told, *pairs, *ratios, ms])
    return cells


def _pair(values: Any) -> str:
    sizes = np.abs(values)
    return f"{np.median(sizes):.2f}, {np.percentile(sizes, 95):.2f}" if len(sizes) else "–"


def _mean(values: Any) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _column(rows: Sequence[TargetRow], which: str, field: str) -> Any:
    values = np.array([getattr(getattr(row, which), field) for row in rows])
    return values[np.isfinite(values)]


def target_verdict(done: Scenes) -> list[Check]:
    """What is asked of every row. A hole that was not told counts as not detected."""
    rows, checks = _rows(done), list[Check]()
    for name, of in rows.items():
        if name in REFUSING:
            wrong = sum(row.wrong for row in of)
            checks.append(at_most(f"{ROWS[name].words}, {len(of)}: wrong answers", wrong, 0))
            told = float(np.mean([not row.refused for row in of]))
            checks.append(at_most(f"{ROWS[name].words}: answered, rightly", told, None))
        else:
            checks += _accuracy(ROWS[name].words, ROWS[name].lateral_mm, of)
    holes = [row for name, of in rows.items() if ROWS[name].kind == "hole" for row in of]
    if holes:
        false = sum(row.false for row in holes) / len(holes)
        checks.append(at_most(f"false holes a picture, of {len(holes)}", false, _FALSE))
    return checks


def _accuracy(words: str, lateral_mm: float | None, rows: list[TargetRow]) -> list[Check]:
    across, turned = _column(rows, "known", "lateral_mm"), _column(rows, "seen", "normal_deg")
    ratio, known = (_column(rows, which, "nees") for which in ("seen", "known"))
    along = _column(rows, "seen", "nees_depth")
    told = sum(not row.refused for row in rows)
    checks = [at_least(f"{words}: told", told / len(rows), _DETECTED)]
    visible = sum(row.visible or 0 for row in rows)
    if visible:
        found = sum(row.found or 0 for row in rows)
        checks.append(at_least(f"{words}: found of {visible} visible", found / visible, _DETECTED))
    if told:
        checks += [
            at_most(
                f"{words}: across, camera known, 95 %", float(np.percentile(across, 95)), lateral_mm, "mm"
            ),
            at_most(f"{words}: normal, 95 %", float(np.percentile(turned, 95)), _NORMAL_DEG, "°"),
            inside(f"{words}: error² over variance told", _mean(ratio), _NEES),
            inside(f"{words}: … along the line of sight", _mean(along), _NEES),
            inside(f"{words}: … with the camera known", _mean(known), _NEES),
        ]
    return checks


TARGETS = Experiment(
    name="targets",
    title="Targets without markers, one pair each.",
    settings=TargetSceneSettings,
    row=TargetRow,
    tasks=target_tasks,
    run=one_target,
    table=target_table,
    verdict=target_verdict,
    runs=200,
    seed=1,
    world="drawn walls, camera and prints off by what vision takes for granted",
    eyes="rendered pictures",
    workers=0,
)
