"""Lines and verdicts of single campaigns, as their experiments judge them; what a superseded one leaves."""

import csv
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from testbed.campaigns.campaign import CampaignRequest
from testbed.campaigns.experiment import Check, Finished
from testbed.campaigns.typed_rows import typed
from testbed.experiments.catalogue import catalogue
from testbed.experiments.positioning.changed import CHANGES, ChangedRow
from testbed.experiments.positioning.corrected_figures import (
    LIMIT_MM,
    checks_of,
    quantile,
    share,
    told,
    worst_mm,
    worst_ratio,
)
from testbed.experiments.positioning.corrected_run import PositioningRow
from testbed.experiments.positioning.told import covered, nees, silent_misses
from testbed.experiments.positioning.worlds import WORLDS, WorldName
from tools.evidence import real_machines
from tools.evidence.kept_rows import MET, RESULTS, ROOT, Kept, headed, kept
from tools.tables import table

ON_PAGES_OF_SIGHT = ("targets", "hole-drives", "marker-limits")  # ``sight`` shows them
_SUPERSEDED = "superseded.csv"
_SUPERSEDED_HEADS = ("rows", "command", "commit", "runs", "limits met", "since", "rows are in git at")
_MOST_MEDIAN_MM, _MOST_RATIO = 1.5, 3.0  # of a changed machine


def supersede(name: str, reason: str, held_at: str, results: Path = RESULTS) -> None:
    """Leave one line of the campaign ``name``, with what it met as judged today; take its rows away.

    ``held_at``: the commit from which git has its rows.
    """
    one = kept(results / name)
    judged = [line[-1] for line in _judged(one) if line[-1]]
    met = f"{judged.count('yes')} of {len(judged)}"
    line = (name, one.command, one.commit, len(one.rows), met, reason, held_at)
    new = not (results / _SUPERSEDED).exists()
    with (results / _SUPERSEDED).open("a", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([_SUPERSEDED_HEADS, line] if new else [line])
    shutil.rmtree(results / name)


def sections(current: Sequence[Kept]) -> dict[str, str]:
    """Every generated section of ``docs/evidence.md`` that shows campaigns one by one."""
    drawn = [one for one in current if one.experiment == "best-mode"]
    changed = [one for one in current if one.experiment == "changed-machine"]
    elsewhere = ("best-mode", "changed-machine", *ON_PAGES_OF_SIGHT)
    others = [one for one in current if one.experiment not in elsewhere]
    others = [one for one in others if not real_machines.counts(one)]
    heads = (
        "rows | command | runs | one look: within 5 mm | median, 95 % | two looks | median, 95 % | stopped"
    )
    heads += " | error² / variance told: before moving, by odometry | in the ellipse | silent misses"
    heads += " | limits met"
    lines = "what was changed | runs | one look: median, worst | within 5 mm | error / σ told | silent misses"
    return {
        "evidence": table(heads, (_campaign(one) for one in drawn)),
        "changed machines": "\n\n".join(
            headed(one, table(lines + " | stopped | limits met", _changes(one))) for one in changed
        ),
        "other campaigns": "\n\n".join(
            headed(one, table("figure | found | asked | met", verdict_lines(one))) for one in others
        ),
    }


def verdict_lines(one: Kept) -> list[list[str]]:
    """The verdict that the experiment itself gives of such rows."""
    experiment = catalogue()[one.experiment].load()
    rows = [typed(experiment.row, row) for row in one.rows]
    request = CampaignRequest(ROOT / "configs", RESULTS)
    done = Finished(request, experiment.settings(), (), rows, len(rows))
    return [[check.what, check.found, check.asked, MET[check.met]] for check in experiment.verdict(done)]


def _judged(one: Kept) -> list[list[str]]:
    """Lines that end with whether what is asked there was met, empty where nothing is."""
    if one.experiment == "changed-machine":
        return _changes(one)
    if one.experiment == "best-mode":
        return [[MET[check.met]] for check in _asked([typed(PositioningRow, row) for row in one.rows])]
    return verdict_lines(one)


def _asked(rows: list[PositioningRow]) -> list[Check]:
    return checks_of(rows, WORLDS[WorldName(rows[0].world)].demands)


def _campaign(one: Kept) -> Sequence[str]:
    """A line of drawn machines; a run that stopped counts as outside."""
    rows = [typed(PositioningRow, row) for row in one.rows]
    first, second = worst_mm(rows, "look1"), worst_mm(rows, "look2")
    before, after = (told(rows, "look1", when) for when in ("before", "after"))
    judged = [check.met for check in _asked(rows) if check.met is not None]
    return [
        f"`docs/results/{one.name}`, commit `{one.commit}`",
        f"`{one.command}`",
        str(len(rows)),
        f"{share(first, LIMIT_MM):.0%}",
        _pair(first, 95),
        f"{share(second, LIMIT_MM):.0%}",
        _pair(second, 95),
        str(sum(map(_stopped, rows))),
        f"{nees(before):.2f}, {nees(after):.2f}",
        f"{covered(before):.0%}, {covered(after):.0%}",
        f"{silent_misses(before, first)}, {silent_misses(after, first)}",
        f"{sum(judged)} of {len(judged)}",
    ]


def _changes(one: Kept) -> list[list[str]]:
    rows = [typed(ChangedRow, row) for row in one.rows]
    return [_change(change, [row.run for row in rows if row.change == change]) for change in _names(rows)]


def _change(change: str, rows: list[PositioningRow]) -> list[str]:
    first = worst_mm(rows, "look1")
    inside, ratio, median = share(first, LIMIT_MM), worst_ratio(rows, "look1"), quantile(first, 50)
    met = inside == 1.0 and median <= _MOST_MEDIAN_MM and ratio <= _MOST_RATIO
    return [
        CHANGES[change].words,
        str(len(rows)),
        _pair(first, 100),
        f"{inside:.0%}",
        f"{ratio:.1f}",
        str(silent_misses(told(rows, "look1", "before"), first)),
        str(sum(map(_stopped, rows))),
        "yes" if met else "NO",
    ]


def _names(rows: Sequence[ChangedRow]) -> list[str]:
    return [name for name in CHANGES if any(row.change == name for row in rows)]


def _pair(values: Any, percent: float) -> str:
    return f"{quantile(values, 50):.2f}, {quantile(values, percent):.2f} mm"


def _stopped(row: PositioningRow) -> bool:
    return bool(row.failure or row.look1.failure or row.look2.failure)
