"""Many runs of one function over Dask's workers: resumable, one row a run, a failure never a zero.

By default the workers are processes of this machine, started for the campaign; with ``scheduler`` they are
those of a Dask cluster that is already there, whose workers have Longreach installed. With no ``workers`` at
all the runs are made in this process, one after the other.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from typer import Option

from foundation.compiled import OUR_PACKAGES
from foundation.configuration import layers
from laboratory.campaigns.rows import Row, read_rows, write_rows
from laboratory.campaigns.workforce import AGAIN, Run, Task, results
from protocol.errors import ConfigurationError, LinkLost
from testbed.cli.options import ConfigDir, JsonFile
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
    """The hash of all files below a directory and its base, with their names.

    Without bytecode, which a worker writes that imports a program from beside its configuration.
    """
    files = ((folder, file) for folder in layers(path) for file in folder.rglob("*") if file.is_file())
    return _hash((str(file.relative_to(folder)), file) for folder, file in files if file.suffix != ".pyc")


def _hash(files: Iterable[tuple[str, Path]]) -> str:
    digest = hashlib.sha256()
    for name, file in sorted(files):
        content = file.read_bytes()
        digest.update(b"%d %d\0" % (len(name), len(content)) + name.encode() + content)
    return digest.hexdigest()[:_DIGITS]


class CampaignRequest(NamedTuple):
    """What a campaign is asked for: ``runs`` from ``seed`` on, rows and pictures in ``out``.

    ``scheduler``: a Dask cluster that is there; else ``workers`` processes are started, or none. ``fresh``:
    no row is reused. ``json_file``: to write results to.
    """

    config_dir: ConfigDir
    out: Annotated[
        Path, Option("--out", help="Rows and pictures; rows that are there are not measured again.")
    ]
    runs: Annotated[int, Option("--count", min=1, help="How many seeds, from --seed on.")] = 1
    seed: Annotated[int, Option(min=0, help="The same seed is the same world; the first of several.")] = 1
    scheduler: Annotated[
        str | None,
        Option(help="A Dask scheduler that is there, such as tcp://host:8786; else workers are started."),
    ] = None
    workers: Annotated[
        int, Option(min=0, max=64, help="How many workers to start; 0: run in this process.")
    ] = 2
    fresh: Annotated[bool, Option("--fresh", help="Measure all rows anew, also those that are there.")] = (
        False
    )
    json_file: JsonFile = None


def run_campaign(
    request: CampaignRequest, run: Run, tasks: Sequence[Task], title: str
) -> tuple[list[Row], int]:
    """A row for each of ``tasks``, in their order, and how many ``request.out/rows.csv`` had already.

    ``run`` (importable by name) turns a configuration directory and a flat task with a unique ``key`` into a
    flat row. Each row gets what is in its task, ``configuration``, ``failure`` (None, or the cause and what
    happened), ``run_s`` and ``cpu_s``. A row is reused when key and configuration are the same, unless it
    failed by no fault of its own (its worker died, or the program broke).

    Raises ConfigurationError for a key given twice, a malformed address and a directory that cannot be made
    (``output.unwritable``), LinkLost when the scheduler does not answer or goes away; the rows done until
    then are in the file.
    """
    evidence = evidence_of(run, request.config_dir)
    names = [(task["key"], configuration_of(evidence, task)) for task in tasks]
    if len(dict(names)) != len(tasks):
        raise ConfigurationError("configuration.duplicate_task", f"{title}: two tasks have the same key")
    try:
        request.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError("output.unwritable", f"{request.out}: {error.strerror}") from error
    path = request.out / "rows.csv"
    rows = read_rows(path)
    conclusive = [row for row in rows if not str(row.get("failure") or "").startswith(AGAIN)]
    there = set() if request.fresh else {_name(row) for row in conclusive}
    to_do = {name: task for name, task in zip(names, tasks, strict=True) if name not in there}
    counts = f"{title}: {len(tasks) - len(to_do)} rows reused, {len(to_do)} measured now"
    out.print(counts, style="dim", highlight=False, soft_wrap=True)
    if to_do:
        checked = partial(_on_same_evidence, run, request.config_dir, evidence)
        workers = min(request.workers, len(to_do))
        configurations = dict(to_do.keys())
        with kept_on_ctrl_c(lambda: f"{len(rows)} rows are kept in {path}"):
            for task, row in results(checked, list(to_do.values()), request.scheduler, workers, title):
                rows.append(task | {"configuration": configurations[task["key"]]} | row)
                write_rows(path, rows)
    newest = {_name(row): row for row in read_rows(path)}
    return [newest[name] for name in names], len(tasks) - len(to_do)


def _name(row: Row) -> tuple[str, str]:
    return row["key"], row["configuration"]


def configuration_of(evidence: Mapping[str, Any], task: Mapping[str, Any]) -> str:
    """Twelve hex digits: the hash of a task and of all that its run depends on beside it."""
    text = json.dumps(plain({"evidence": evidence, "task": task}), sort_keys=True, default=repr)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def evidence_of(run: Run, config_dir: Path) -> dict[str, Any]:
    """What a run depends on beside its task: the function, sources, versions, configuration files."""
    return {
        "function": f"{run.__module__}.{run.__qualname__}",
        "sources": sources_hash(),
        "versions": library_versions(),
        "files": content_hash(config_dir),
    }


def _on_same_evidence(run: Run, config_dir: Path, wanted: Mapping[str, Any], task: Task) -> Row:
    """The run, on a worker whose sources, files and libraries are those of the campaign's client."""
    here = evidence_of(run, config_dir)
    if other := [name for name in wanted if wanted[name] != here[name]]:
        raise LinkLost(f"{AGAIN}other_worker", f"the worker's {', '.join(other)} are not those of the client")
    return run(config_dir, task)
