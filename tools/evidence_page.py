"""The tables of docs/evidence.md and docs/evidence_history.md, made from the rows under docs/results;
``python -m tools.evidence_page``.

``python -m tools.evidence_page keep RUN NAME COMMIT COMMAND…`` copies a campaign's rows there first: RUN is
its directory, COMMIT what it ran on, COMMAND what was typed. Rows that no longer count, for what was changed
since, have the reason in their about.json (``superseded``).
"""

import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from testbed.campaigns.campaign import CampaignRequest
from testbed.campaigns.experiment import Check, Finished
from testbed.campaigns.row_file import RowFile
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
from tools.protocol_page import filled
from tools.tables import table

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "docs" / "evidence.md", ROOT / "docs" / "evidence_history.md")
RESULTS = ROOT / "docs" / "results"
ON_PAGES_OF_SIGHT = ("targets", "hole-drives", "marker-limits")  # ``tools.sight_pages`` shows them
MET = {True: "yes", False: "NO", None: ""}
_ABOUT = "about.json"
_MOST_MEDIAN_MM, _MOST_RATIO = 1.5, 3.0  # of a changed machine


class Kept(NamedTuple):
    """A campaign's rows as they stand under docs/results, and what they are evidence of.

    ``superseded``: why they are history, empty for those that count.
    """

    name: str
    command: str
    commit: str
    rows: list[dict[str, Any]]
    superseded: str = ""

    @property
    def experiment(self) -> str:
        """Its name, as typed: ``longreach experiment NAME …``."""
        return self.command.split()[2]


def kept(directory: Path) -> Kept:
    """The campaign in ``directory``."""
    about = json.loads((directory / _ABOUT).read_text(encoding="utf-8"))
    rows = RowFile(directory / "rows.csv").rows
    return Kept(directory.name, about["command"], about["commit"], rows, about.get("superseded", ""))


def every_kept(results: Path = RESULTS) -> list[Kept]:
    """All campaigns below ``results``, by name."""
    return [kept(path.parent) for path in sorted(results.glob(f"*/{_ABOUT}"))]


def keep(run: Path, name: str, commit: str, command: str, results: Path = RESULTS) -> Path:
    """Copy the rows of ``run``, and their tasks with the hashes of configuration and sources."""
    into = results / name
    into.mkdir(parents=True, exist_ok=True)
    for file in ("rows.csv", "tasks.jsonl"):
        shutil.copyfile(run / file, into / file)
    about = {"command": command, "commit": commit}
    (into / _ABOUT).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    return into


def sections(results: Path = RESULTS) -> dict[str, str]:
    """Every generated section by its name."""
    found = every_kept(results)
    current = [one for one in found if not one.superseded]
    drawn = [one for one in current if one.experiment == "best-mode"]
    changed = [one for one in current if one.experiment == "changed-machine"]
    elsewhere = ("best-mode", "changed-machine", *ON_PAGES_OF_SIGHT)
    others = [one for one in current if one.experiment not in elsewhere]
    earlier = [one for one in found if one.superseded]
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
        "history": table("rows | command | runs | limits met then | since", map(_history, earlier)),
    }


def headed(one: Kept, rows: str) -> str:
    """A table under what was typed, on which commit, and where its rows are."""
    about = f"`{one.command}`, commit `{one.commit}`, `docs/results/{one.name}`"
    return f"{about}, {len(one.rows)} rows:\n\n{rows}"


def verdict_lines(one: Kept) -> list[list[str]]:
    """The verdict that the experiment itself gives of such rows."""
    experiment = catalogue()[one.experiment].load()
    rows = [typed(experiment.row, row) for row in one.rows]
    request = CampaignRequest(ROOT / "configs", RESULTS)
    done = Finished(request, experiment.settings(), (), rows, len(rows))
    return [[check.what, check.found, check.asked, MET[check.met]] for check in experiment.verdict(done)]


def _history(one: Kept) -> list[str]:
    """A line of rows that no longer count."""
    judged = [line[-1] for line in _judged(one) if line[-1]]
    return [
        f"`docs/results/{one.name}`, commit `{one.commit}`",
        f"`{one.command}`",
        str(len(one.rows)),
        f"{judged.count('yes')} of {len(judged)}",
        one.superseded,
    ]


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


def rendered(text: str) -> str:
    """``text`` with the tables made anew."""
    return filled(text, sections())


if __name__ == "__main__":
    if sys.argv[1:2] == ["keep"]:
        keep(Path(sys.argv[2]), sys.argv[3], sys.argv[4], " ".join(sys.argv[5:]))
    for page in PAGES:
        page.write_text(rendered(page.read_text(encoding="utf-8")), encoding="utf-8")
