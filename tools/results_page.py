"""Rows of campaigns that are kept in docs/results, and the tables made of them.

``python -m tools.results_page keep runs/best-mode best_mode_lab`` keeps the rows of a campaign on the sources
that made them, with the commit; ``python -m tools.results_page`` writes the tables of the pages anew.
"""

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from protocol.errors import ConfigurationError
from testbed.campaigns.campaign import evidence_of
from testbed.campaigns.row_file import Row, RowFile
from testbed.campaigns.typed_rows import typed
from testbed.experiments.positioning.corrected import by_arm
from testbed.experiments.positioning.corrected_figures import (
    LIMIT_MM,
    checks_of,
    quantile,
    told,
    worst_mm,
)
from testbed.experiments.positioning.corrected_run import PositioningRow, one_run
from testbed.experiments.positioning.told import nees, silent_misses
from testbed.experiments.positioning.worlds import WORLDS, WorldName
from tools.protocol_page import filled
from tools.tables import table

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results"
PAGES = (ROOT / "README.md", RESULTS / "README.md")
HEAD = (
    "world | arm | runs, seeds | eyes | open-loop step | one look | two looks "
    "| error² over variance | silent misses | limits | commit, rows"
)
_DIGITS = 6  # of a kept number
_TIMES = ("run_s",)


class KeptRows(NamedTuple):
    """The rows of one file of docs/results, all of one world, and what holds for all of them."""

    name: str
    commit: str
    eyes: str
    assignments: str
    world: WorldName
    rows: list[PositioningRow]


def keep(directory: Path, name: str, results: Path = RESULTS, root: Path = ROOT) -> Path:
    """The file with the rows of best-mode in ``directory``, each with its eyes, ``--set`` and commit.

    Raises ConfigurationError (``results.…``) without rows, on changed files, and when code, configuration or
    libraries here are not those of the rows: their commit would be told wrongly.
    """
    rows = RowFile(directory / "rows.csv").rows
    if not rows:
        raise ConfigurationError("results.no_rows", f"{directory / 'rows.csv'} has no rows")
    if changed := _git(root, "status", "--porcelain", "--untracked-files=no"):
        raise ConfigurationError("results.changed_files", f"commit first: {', '.join(changed.split()[1::2])}")
    noted = dict(_noted(directory / "tasks.jsonl"))
    here = _evidence(root)
    commit = _git(root, "rev-parse", "--short=10", "HEAD")
    found = []
    for row in sorted(rows, key=lambda row: (str(row["arm"]), row["seed"])):
        made = noted.get(str(row["configuration"]), {})
        if other := [part for part, value in here.items() if made.get(part) != value]:
            why = f"{row['key']}: {', '.join(other)} here are not those that made the row"
            raise ConfigurationError("results.other_sources", why)
        asked = {"eyes": made["task"]["eyes"], "set": " ".join(made["task"]["assignments"])}
        found.append({"seed": row["seed"], "commit": commit} | asked | _rounded(row))
    path = results / f"{name}.csv"
    path.unlink(missing_ok=True)
    file = RowFile(path)
    for whole in found:
        file.append(whole)
    return path


def _evidence(root: Path) -> dict[str, Any]:
    """What rows made here would be evidence of, as a campaign notes it."""
    whole: dict[str, Any] = json.loads(json.dumps(evidence_of(partial(one_run, root / "configs"))))
    return whole


def _noted(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    for line in path.read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        yield entry["configuration"], entry


def _rounded(row: Row) -> Row:
    kept = {name: value for name, value in row.items() if name not in _TIMES}
    return {
        name: float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
        for name, value in kept.items()
    }


def _git(root: Path, *words: str) -> str:
    return subprocess.run(
        ["git", *words], cwd=root, check=True, capture_output=True, text=True
    ).stdout.strip()


def kept(path: Path) -> KeptRows:
    """What is in one file of docs/results. Raises ConfigurationError (``results.mixed``) when mixed."""
    rows = RowFile(path).rows
    found = [{str(row.get(name) or "") for row in rows} for name in ("commit", "eyes", "set", "world")]
    if any(len(values) != 1 for values in found):
        raise ConfigurationError("results.mixed", f"{path}: rows of several commits, eyes, --set or worlds")
    commit, eyes, assignments, world = (values.pop() for values in found)
    return KeptRows(
        path.stem, commit, eyes, assignments, WorldName(world), [typed(PositioningRow, row) for row in rows]
    )


def best_mode(files: Sequence[KeptRows], link: str) -> str:
    """The table of all kept campaigns, a line for each arm; ``link``: from the page to docs/results."""
    lines = [
        line
        for file in files
        for arm, rows in by_arm(file.rows).items()
        for line in _lines(file, arm, rows, link)
    ]
    return table(HEAD, lines) if lines else "No rows are kept yet."


def _lines(file: KeptRows, arm: str, rows: Sequence[PositioningRow], link: str) -> Iterator[list[str]]:
    seeds = [row.seed for row in rows]
    ends = {name: worst_mm(rows, name) for name in ("one_shot", "look1", "look2")}
    before = told(rows, "look1", "before")
    missed = [check.what for check in checks_of(rows, WORLDS[file.world].demands) if check.met is False]
    yield [
        f"`{file.world}`" + (f", `{file.assignments}`" if file.assignments else ""),
        f"`{arm}`",
        f"{len(rows)}, {min(seeds)} to {max(seeds)}",
        file.eyes,
        *(_shown(worst) for worst in ends.values()),
        f"{nees(before):.2f}",
        str(silent_misses(before, ends["look1"])),
        "met" if not missed else f"not met: {'; '.join(missed)}",
        f"{file.commit}, [{file.name}.csv]({link}{file.name}.csv)",
    ]


def _shown(worst: Any) -> str:
    """How many end within 5 mm, median and 95 % of the worse of |x| and |y|, of those that came to an end."""
    within = int(np.count_nonzero(worst <= LIMIT_MM))
    return f"{within} of {len(worst)}; {quantile(worst, 50):.2f} / {quantile(worst, 95):.2f} mm"


def sections(page: Path, results: Path = RESULTS) -> Mapping[str, str]:
    """Every generated section of a page by its name."""
    link = "docs/results/" if page.parent == ROOT else ""
    return {"best mode": best_mode([kept(path) for path in sorted(results.glob("best_mode*.csv"))], link)}


def rendered(page: Path) -> str:
    """The page with its tables made anew."""
    return filled(page.read_text(encoding="utf-8"), sections(page))


if __name__ == "__main__":
    if sys.argv[1:2] == ["keep"]:
        print(keep(Path(sys.argv[2]), sys.argv[3]))
    for written in PAGES:
        written.write_text(rendered(written), encoding="utf-8")
