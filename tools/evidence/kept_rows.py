"""Campaigns kept under docs/results: rows.csv, tasks.jsonl, and about.json with what was typed."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from testbed.campaigns.row_file import RowFile

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
MET = {True: "yes", False: "NO", None: ""}
_ABOUT = "about.json"


class Kept(NamedTuple):
    """A campaign's rows as they stand under docs/results, and what they are evidence of."""

    name: str
    command: str
    commit: str
    rows: list[dict[str, Any]]

    @property
    def experiment(self) -> str:
        """Its name, as typed: ``longreach experiment NAME …``."""
        return self.command.split()[2]


def kept(directory: Path) -> Kept:
    """The campaign in ``directory``."""
    about = json.loads((directory / _ABOUT).read_text(encoding="utf-8"))
    rows = RowFile(directory / "rows.csv").rows
    return Kept(directory.name, about["command"], about["commit"], rows)


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


def committed(name: str) -> str:
    """The last commit that changed the rows of ``name``. Raises SystemExit when git has not got them all."""
    where = ("--", f"docs/results/{name}")
    git = ("git", "-C", str(ROOT))
    if subprocess.check_output((*git, "status", "--porcelain", *where), text=True).strip():
        sys.exit(f"docs/results/{name} has changes that are not committed: commit them, then supersede it")
    found = subprocess.check_output((*git, "log", "-1", "--format=%h", *where), text=True).strip()
    return found or sys.exit(f"git has no docs/results/{name}")


def headed(one: Kept, rows: str) -> str:
    """A table under what was typed, on which commit, and where its rows are."""
    about = f"`{one.command}`, commit `{one.commit}`, `docs/results/{one.name}`"
    return f"{about}, {len(one.rows)} rows:\n\n{rows}"
