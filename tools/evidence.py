"""How old each row of docs/evidence.md is: `python -m tools.evidence` (needs the repository's history).

A row came with the commit that first had its seed, else its numbers, on a page. What its experiment can read,
its module with all of ours that it imports and the configuration, may have changed since: rows of unchanged
sources are today's, the others are as old as they say. Seeds that a number in configs/ was taken from count
for none.
"""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from laboratory.campaigns.campaign import PACKAGES, imported_sources
from laboratory.experiments.catalogue import OURS
from testbed.reporting.console import out, table

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "evidence.md"
_COMMAND = re.compile(r"`([a-z0-9-]+)((?: --?[^`]*)?)`")
_SEEDS = re.compile(r"seeds? ((?:\d{3,}(?:, | to | and )?)+)")
_OPTION = r"--{}[ =](\S+)"


class EvidenceRow(NamedTuple):
    """A row: its first cell, the experiment's module, its seeds, and the cell of its numbers."""

    what: str
    module: str
    seeds: range
    numbers: str


class RowAge(NamedTuple):
    """When a row's numbers came, and what of its sources changed since."""

    row: EvidenceRow
    commit: str
    date: str
    files: int
    lines: int


def rows_of(page: str) -> Iterator[EvidenceRow]:
    """The rows of tables that have a column of commands; one without a command has the one before's."""
    module, seeds, column = "", range(0), -1
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")] if line.startswith("|") else []
        if not cells or set("".join(cells)) <= {"-", " ", ":"}:
            column = column if cells else -1
        elif column < 0:
            column = next((k for k, cell in enumerate(cells) if cell.startswith("command")), -1)
        else:
            if (found := _COMMAND.search(cells[column])) and found[1] in OURS:
                module = _module(found[1], found[2])
            if (first := _seeds(cells[column])) is not None:
                seeds = first
            yield EvidenceRow(cells[0], module, seeds, cells[column + 2])


def _module(name: str, options: str) -> str:
    entry = OURS[name]
    method = re.search(_OPTION.format("method"), options)
    place = entry.places[method[1]] if method else next(iter(entry.places.values()))
    return entry.package + place.partition(":")[0]


def _seeds(command: str) -> range | None:
    seed, count = (re.search(_OPTION.format(name), command) for name in ("seed", "count"))
    if seed is None or not seed[1].strip("`,").isdigit():
        return None
    first = int(seed[1].strip("`,"))
    return range(first, first + (int(count[1].strip("`,")) if count else 1))


def tuned_seeds() -> dict[int, str]:
    """Seed → the key of configs/ whose value was taken from it, by the comment beside it."""
    found: dict[int, str] = {}
    for path in sorted((ROOT / "configs").rglob("*.yaml")):
        for line in path.read_text(encoding="utf-8").splitlines():
            key, _, comment = line.partition("#")
            for said in _SEEDS.findall(comment):
                for first, last in re.findall(r"(\d+)(?: to (\d+))?", said):
                    where = f"{path.relative_to(ROOT)}: {key.split(':')[0].strip()}"
                    found |= dict.fromkeys(range(int(first), int(last or first) + 1), where)
    return found


def age_of(row: EvidenceRow) -> RowAge:
    """How old ``row`` is. Raises subprocess.CalledProcessError without the repository's history."""
    first = rf"\b{row.seeds.start}\b" if row.seeds.start > 999 else re.escape(row.numbers)
    words = ("log", "--reverse", "--format=%h %cs", "--pickaxe-regex", f"-S{first}", "--", "*.md")
    seen = _git(*words).splitlines()
    commit, date = seen[0].split() if seen else ("", "")
    if not commit:
        return RowAge(row, "uncommitted", "", 0, 0)
    roots = {name: ROOT / name for name in PACKAGES}
    files = [str(path.relative_to(ROOT)) for path in imported_sources(row.module, roots).values()]
    changed = _git("diff", "--numstat", commit, "--", *files, "configs").splitlines()
    counts = [[int(n) for n in line.split("\t")[:2] if n.isdigit()] for line in changed]
    return RowAge(row, commit, date, len(changed), sum(map(sum, counts)))


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout


def main() -> int:
    """Print the table; exit status 1 where a row's seeds were tuned on."""
    ages = [age_of(row) for row in rows_of(PAGE.read_text(encoding="utf-8"))]
    cells = [
        (
            age.row.what,
            age.commit,
            age.date,
            "today's" if not age.files else f"{age.lines} lines of {age.files} files",
        )
        for age in ages
    ]
    out.print(
        table("rows of docs/evidence.md", ("row", "numbers since", "of", "its sources changed by"), cells)
    )
    current = sum(not age.files for age in ages)
    out.print(f"{current} of {len(ages)} rows are of today's sources", highlight=False)
    tuned = tuned_seeds()
    bad = {(age.row.what, tuned[seed]) for age in ages for seed in age.row.seeds if seed in tuned}
    for what, where in sorted(bad):
        out.print(f"{what}: has seeds that {where} was taken from", style="red", highlight=False)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
