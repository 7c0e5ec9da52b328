"""Many runs of one function over Dask's workers: resumable, one row a run, a failure never a zero.

By default the workers are processes of this machine, started for the campaign; with ``scheduler`` they are
those of a Dask cluster that is already there, whose workers have Longreach installed. With no ``workers`` at
all the runs are made in this process, one after the other.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from foundation.compiled import OUR_PACKAGES
from foundation.configuration import layers
from laboratory.campaigns.rows import Row, RowFile
from laboratory.campaigns.workforce import AGAIN, Run, Task, results
from protocol.errors import ConfigurationError, LinkLost
from testbed.reporting.console import kept_on_ctrl_c, out, plain
from testbed.reporting.run_record import library_versions

_ROOT = Path(__file__).parents[2]
_DIGITS = 16


@cache
def sources_hash() -> str:
    """The hash of all sources of ours, wherever this package is installed."""
    files = (file for package in OUR_PACKAGES for file in (_ROOT / package).rglob("*.py"))
    return _hash((str(file.relative_to(_ROOT)), file) for file in files)


def content_hash(path: Path) -> str:
    """The hash of a file, or of all files below a directory and its base, with their names."""
    folders = [] if path.is_file() else layers(path)
    files = [(str(f.relative_to(folder)), f) for folder in folders for f in folder.rglob("*") if f.is_file()]
    return _hash(files or [("", path)])


def _hash(files: Iterable[tuple[str, Path]]) -> str:
    digest = hashlib.sha256()
    for name, file in sorted(files):
        content = file.read_bytes()
        digest.update(b"%d %d\0" % (len(name), len(content)) + name.encode() + content)
    return digest.hexdigest()[:_DIGITS]


class CampaignRequest(NamedTuple):
    """What a campaign is asked for: ``runs`` from ``seed`` on, rows and pictures in ``out``.

    ``scheduler``: a Dask cluster that is there; else ``workers`` processes are started, or none. ``fresh``:
    no row is reused. ``json``: a file to write figures to.
    """

    config_dir: Path
    out: Path
    runs: int = 1
    seed: int = 1
    scheduler: str | None = None
    workers: int = 2
    fresh: bool = False
    json: Path | None = None


class Campaign(NamedTuple):
    """One row for each task, in their order; ``reused`` of them were there already."""

    rows: list[Row]
    reused: int


def run_campaign(request: CampaignRequest, function: Run, tasks: Sequence[Task], title: str) -> Campaign:
    """The rows of ``tasks``; those that ``request.out/rows.csv`` lacks are measured now.

    ``function`` (importable by name, or a partial of such) turns a flat task with a unique ``key`` into a
    flat or typed row. Each row gets ``key``, ``configuration``, ``failure`` (None, or the cause and what
    happened), ``run_s`` and ``cpu_s``. A row is reused when key and configuration are the same, unless it
    failed by no fault of its own (its worker died, or the program broke).

    A value that is bytes becomes a file; its cell is the name, below ``request.out``.

    Raises ConfigurationError for a key given twice or a malformed address, LinkLost when the scheduler does
    not answer, has no workers, or goes away; the rows done until then are kept.
    """
    directory = request.out
    evidence = evidence_of(function)
    configurations = {str(task["key"]): configuration_of(evidence, task) for task in tasks}
    if len(configurations) != len(tasks):
        raise ConfigurationError("configuration.duplicate_task", f"{title}: two tasks have the same key")
    file = RowFile(directory / "rows.csv")
    kept = [] if request.fresh else [row for row in file.rows if _conclusive(row)]
    done = {(str(row["key"]), str(row["configuration"])): row for row in kept}
    to_do = [task for task in tasks if (str(task["key"]), configurations[str(task["key"])]) not in done]
    asked = ({"configuration": configurations[str(task["key"])], "task": task} for task in tasks)
    _note(directory, [each | {"title": title} | evidence for each in asked])
    told = f"{title}: {len(tasks) - len(to_do)} rows reused, {len(to_do)} measured now"
    out.print(told, style="dim", highlight=False, soft_wrap=True)
    if to_do:
        checked = partial(_on_same_evidence, function, evidence)
        workers = min(request.workers, len(to_do))
        with kept_on_ctrl_c(lambda: f"{len(file.rows)} rows are kept in {file.path}"):
            for task, row in results(checked, to_do, request.scheduler, workers, title):
                key = str(task["key"])
                named = {"key": key, "configuration": configurations[key]}
                whole = named | _files_written(directory, "-".join(named.values()), row)
                done[key, configurations[key]] = file.append(whole)
    rows = [{name: done[item].get(name) for name in file.columns} for item in configurations.items()]
    return Campaign(rows, len(tasks) - len(to_do))


def configuration_of(evidence: Mapping[str, Any], task: Mapping[str, Any]) -> str:
    """Twelve hex digits: the hash of a task and of all that its run depends on beside it."""
    text = json.dumps(plain({"evidence": evidence, "task": task}), sort_keys=True, default=repr)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def evidence_of(function: Run) -> dict[str, Any]:
    """What a run depends on beside its task: sources, versions, the function and what is bound to it.

    A bound path counts by its content.
    """
    bound: list[Any] = []
    whole: Callable[..., Any] = function
    while isinstance(whole, partial):
        bound += [*whole.args, *sorted(whole.keywords.items())]
        whole = whole.func
    return {
        "function": f"{whole.__module__}.{whole.__qualname__}",
        "sources": sources_hash(),
        "versions": library_versions(),
        "bound": [content_hash(value) if isinstance(value, Path) else plain(value) for value in bound],
    }


def _on_same_evidence(function: Run, wanted: Mapping[str, Any], task: Task) -> Any:
    """The run, on a worker whose sources, files and libraries are those of the campaign's client."""
    here = evidence_of(function)
    if other := [name for name in wanted if wanted[name] != here[name]]:
        raise LinkLost(f"{AGAIN}other_worker", f"the worker's {', '.join(other)} are not those of the client")
    return function(task)


def _conclusive(row: Row) -> bool:
    return not str(row.get("failure") or "").startswith(AGAIN)


def _files_written(directory: Path, stem: str, row: Row) -> Row:
    """``row`` with the name of a file below ``directory`` in place of every value that is bytes."""
    kept = dict(row)
    for column, value in row.items():
        if isinstance(value, bytes):
            kept[column] = f"files/{stem}.{column}"
            (directory / "files").mkdir(exist_ok=True)
            (directory / kept[column]).write_bytes(value)
    return kept


def _note(directory: Path, entries: Sequence[Mapping[str, Any]]) -> None:
    """Write what the configurations' hashes stand for to ``tasks.jsonl``."""
    path = directory / "tasks.jsonl"
    lines = [json.dumps(plain(entry), sort_keys=True, default=repr) for entry in entries]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        known = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        path.write_text("".join(f"{line}\n" for line in dict.fromkeys(known + lines)), encoding="utf-8")
    except OSError as error:
        raise ConfigurationError("output.unwritable", f"{path}: {error.strerror}") from error
