"""`longreach experiment rules`: what a rule is worth: the same drawn machines with it and without it.

A rule is a group of mechanisms that the configuration can switch off. A whole subject is switched off first;
it is halved only where that makes the figures worse. Every run is compared with the same seed as shipped, so
the difference is the rule's; a one-sided Wilcoxon test says whether it is beyond chance.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table
from scipy import stats

from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, at_least, seeds
from laboratory.experiments.positioning.corrected_run import driven, prepared
from laboratory.experiments.positioning.results import CONFIDENT, LIMIT_MM, quantile
from laboratory.experiments.positioning.worlds import WORLDS, WorldName
from laboratory.experiments.robustness.parking import park_and_watch
from laboratory.experiments.robustness.resting_machines import REAL
from testbed.reporting.console import table

SHIPPED = "as shipped"
LOOK, REST = "one look", "at rest"
_CHANCE = 0.05
_FAILED_MM = 50.0  # a run that stops counts as so far off: larger than any that ends
_NONE = "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"
_NO_METERING = f"controller.parking.oil_mrad_bar={_NONE}"
_NO_NUDGES = "controller.parking.loaded=[false, false, false, false, false, false]"
_LOCAL = "vision.programs.local_map"
_NO_CAMERA = "vision.markers.calibration.enabled=false"


class Rule(NamedTuple):
    """What is switched off, in words and as assignments; in which ``subjects`` that can show.

    ``sides``: False where the widths of backlash that commissioning found are withheld.
    """

    words: str
    subjects: tuple[str, ...]
    assignments: tuple[str, ...] = ()
    sides: bool = True


RULES: Mapping[str, Rule] = {
    "none": Rule(SHIPPED, (LOOK, REST)),
    "parking": Rule("parking: the joint law goes on", (LOOK, REST), ("controller.parking.enabled=false",)),
    "small_moves": Rule(
        "all of parking but shut valves and jog pulses", (LOOK, REST),
        (_NO_METERING, _NO_NUDGES), sides=False,
    ),
    "metering": Rule("flow-metered pulses, decompression", (LOOK, REST), (_NO_METERING,)),
    "pressure_pulses": Rule("pressure-terminated pulses", (REST,), (_NO_NUDGES,)),
    "backlash_sides": Rule("sides of backlash", (LOOK, REST), sides=False),
    "take_up": Rule(
        "take-up that learns", (LOOK,), (f"{_LOCAL}.take_up.most_rad=7.0e-4", f"{_LOCAL}.take_up.repeats=0")
    ),
    "more_corrections": Rule(
        "more corrections while outside", (LOOK,), ("vision.programs.positioning.outside=0",)
    ),
    "camera": Rule("camera calibration", (LOOK,), (_NO_CAMERA,)),
    "camera_time": Rule(
        "camera delay, waiting for rest", (LOOK,),
        (f"{_LOCAL}.delay_std_s=0.0", f"{_LOCAL}.at_rest.pictures=1"),
    ),
    "arm_fields": Rule(
        "fields of the arm's errors", (LOOK,), (f"{_LOCAL}.field_stds=[1.0e-6, 1.0e-6, 1.0e-6, 1.0e-6]",)
    ),
    "prints_and_drift": Rule(
        "shared prints, drift of the right eye", (LOOK,),
        ("vision.markers.shared_prints=false", "vision.markers.offset_drift_px=0.0"),
    ),
}  # fmt: skip
"""Name → rule. A rule is whatever assignments can switch off: nothing in the product knows of this table."""


class RulesSettings(NamedTuple):
    """Which rules, on which drawn machines."""

    only: Annotated[list[str] | None, typer.Option(help="Only this rule (and none); repeatable.")] = None
    subject: Annotated[str | None, typer.Option(help=f"'{LOOK}' or '{REST}'; both without it.")] = None
    minutes: Annotated[float, typer.Option(min=0.1, help="At rest, after parking.")] = 2.0


class RuleRow(NamedTuple):
    """One machine without one rule. ``error_mm``: of the tool after one look, or moved at rest, at most.

    ``probability``: predicted before moving, of ending inside the tolerance. ``rested_s``: until parked.
    """

    seed: int
    world: str
    subject: str
    rule: str
    failure: str
    cpu_s: float
    error_mm: float = float("nan")
    probability: float = float("nan")
    rested_s: float = float("nan")


RuleRows = Finished[RulesSettings, RuleRow]


def rule_tasks(request: CampaignRequest, settings: RulesSettings) -> list[Task]:
    """Every rule on the same seeds, both worlds in turn. Raises BadParameter for what is not known."""
    names = list(dict.fromkeys(["none", *(settings.only or RULES)]))
    if unknown := sorted(set(names) - set(RULES)):
        raise typer.BadParameter(f"no rule '{unknown[0]}'; known: {', '.join(RULES)}")
    subjects = (LOOK, REST) if settings.subject is None else (settings.subject,)
    if unknown := sorted(set(subjects) - {LOOK, REST}):
        raise typer.BadParameter(f"no subject '{unknown[0]}'; known: {LOOK}, {REST}")
    worlds = (WorldName.REAL, WorldName.CRANE_REAL)
    return [
        {"key": f"{subject}-{seed}-{name}", "seed": seed, "rule": name, "subject": subject}
        | {"world": str(worlds[seed % 2]), "minutes": settings.minutes}
        for seed in seeds(request)
        for subject in subjects
        for name in names
        if subject in RULES[name].subjects
    ]


def without_rule(config_dir: Path, task: Task) -> dict[str, Any]:
    """The row of one machine without one rule."""
    rule, world = RULES[task["rule"]], WorldName(task["world"])
    asked = {"arm": WORLDS[world].arm, "assignments": list(rule.assignments), "sides": rule.sides}
    row = {name: task[name] for name in ("seed", "world", "subject", "rule")}
    if task["subject"] == REST:
        parks = task["rule"] != "parking"
        rest = {"valves": REAL, "law": "parking", "minutes": task["minutes"], "parks": parks, "known": 1.0}
        found = park_and_watch(config_dir, {"seed": task["seed"]} | asked | rest)
        return row | {"error_mm": found["moved_mm"], "rested_s": found["rested_s"]}
    look = {"seed": task["seed"], "world": task["world"], "eyes": "model"}
    rig = prepared(config_dir, look | asked | {"adapting": True, "commissioned": True})
    branch = driven(rig, {})
    return row | {
        "failure": branch.failure, "error_mm": branch.worst_mm, "probability": branch.before.probability,
        "rested_s": 1e-9 * rig.world.time_ns,
    }  # fmt: skip


def _paired_rows(done: RuleRows) -> dict[tuple[str, str, str], tuple[list[RuleRow], list[RuleRow]]]:
    """(subject, world, rule) → rows as shipped and without the rule, of the same seeds in the same order."""
    rows = {(row.subject, row.world, row.rule, row.seed): row for row in done.rows}
    pairs: dict[tuple[str, str, str], tuple[list[RuleRow], list[RuleRow]]] = {}
    for (subject, world, rule, seed), row in rows.items():
        shipped = rows.get((subject, world, "none", seed))
        if shipped is not None:
            before, without = pairs.setdefault((subject, world, rule), ([], []))
            before.append(shipped)
            without.append(row)
    return pairs


def errors_mm(rows: Sequence[RuleRow]) -> np.ndarray:
    """Errors (n,), mm; of runs that stopped, more than any other's."""
    found = np.array([row.error_mm for row in rows])
    return np.where(np.isfinite(found), found, _FAILED_MM)


def worse_by_chance(before: np.ndarray, without: np.ndarray) -> float:
    """Probability of errors ``without`` that are so much larger than ``before``, by chance alone."""
    if np.array_equal(before, without):
        return 1.0
    return float(stats.wilcoxon(without, before, alternative="greater").pvalue)


def rules_table(done: RuleRows) -> list[Table]:
    """A line a subject, world and rule: errors without it, and whether they are larger beyond chance."""
    lines = []
    for (subject, world, rule), (before, without) in sorted(_paired_rows(done).items()):
        mm, chance = errors_mm(without), worse_by_chance(errors_mm(before), errors_mm(without))
        missed = sum(row.probability >= CONFIDENT and row.error_mm > LIMIT_MM for row in without)
        stopped = sum(not np.isfinite(row.error_mm) for row in without)
        cells = [f"{quantile(mm, q):.2f}" for q in (50, 95)]
        rested = f"{np.nanmedian([row.rested_s for row in without]):.0f}"
        verdict = "" if rule == "none" else "worse" if chance < _CHANCE else "no"
        counts = (*cells, missed, stopped, rested, f"{chance:.3f}", verdict)
        lines.append((subject, world, RULES[rule].words, len(mm), *counts))
    headings = ("subject", "world", "switched off", "runs", "median mm", "95 %", "undetected misses",
                "stopped", "seconds", "by chance", "worse beyond chance")  # fmt: skip
    return [table("emulated degraded machines, the same seeds with and without each rule", headings, lines)]


def rules_verdict(done: RuleRows) -> list[Check]:
    """Whether every rule was tried on as many machines as the product as shipped was."""
    pairs = _paired_rows(done)
    whole = min((len(before) for before, _ in pairs.values()), default=0)
    return [at_least("machines a rule, at least", float(whole), 1.0)]


RULES_EXPERIMENT = Experiment(
    name="rules",
    title="What each rule is worth: the same machines with it and without it.",
    settings=RulesSettings,
    row=RuleRow,
    tasks=rule_tasks,
    run=without_rule,
    table=rules_table,
    verdict=rules_verdict,
    runs=16,
    seed=52_001,
    world="emulated degraded machines (real, crane-real), commissioning stated",
)
