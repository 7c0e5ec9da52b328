"""Many runs of one function over Dask's workers: resumable, one row a run, a failure never a zero.

By default the workers are processes of this machine, started for the campaign; with ``scheduler`` they are
those of a Dask cluster that is already there, whose workers have Longreach installed. With no ``workers`` at
all the runs are made in this process, one after the other.
"""

import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from foundation.compiled import imported_names
from foundation.configuration import layers
from laboratory.campaigns.rows import Row, RowFile
from laboratory.campaigns.workforce import AGAIN, Run, Task, results
from protocol.errors import ConfigurationError, LinkLost
from testbed.reporting.console import kept_on_ctrl_c, out, plain
from testbed.reporting.run_record import library_versions

PACKAGES = (
    "foundation",
    "protocol",
    "nominal_arm",
    "structured_text",
    "controller",
    "controller_st",
    "plant_emulator",
    "vision_pc",
    "conformance",
    "dissector",
    "testbed",
    "laboratory",
    "longreach",
    "longreach_ros2",
)
_SCENARIOS = "scenarios"
_DIGITS = 16


class Provenance(NamedTuple):
    """The code behind a run: hash of the sources, and the versions of Python, Longreach and libraries."""

    function: str
    sources: str
    versions: Mapping[str, str]


def provenance_of(function: Callable[..., Any]) -> Provenance:
    """The provenance of a campaign's function, or of a partial of such."""
    while isinstance(function, partial):
        function = function.func
    module = function.__module__
    return Provenance(f"{module}.{function.__qualname__}", sources_hash(module), library_versions())


@cache
def sources_hash(module: str) -> str:
    """The hash of the sources of ``module`` and of all of ours that it imports, directly or not."""
    package = module.partition(".")[0]
    roots = {name: _root(name) for name in {*PACKAGES, package}}
    sources = imported_sources(module, {name: root for name, root in roots.items() if root is not None})
    return _hash((name.encode(), sources[name].read_bytes()) for name in sorted(sources))


def imported_sources(module: str, roots: Mapping[str, Path]) -> dict[str, Path]:
    """Module name → file, for ``module`` and what it imports, directly or not, of the packages ``roots``.

    ``roots``: top-level package → its directory (or file). Imports inside of functions count too.
    """
    found: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = None if name in found else _file_of(name, roots)
        if path is None:
            continue
        found[name] = path
        waiting += [name.rpartition(".")[0], *imported_names(path, name)]
    return found


def _file_of(name: str, roots: Mapping[str, Path]) -> Path | None:
    package, *inner = name.split(".")
    if package not in roots:
        return None
    path = roots[package].joinpath(*inner)
    candidates = (path / "__init__.py", path.with_suffix(".py"), path)
    return next((file for file in candidates if file.suffix == ".py" and file.is_file()), None)


def _root(package: str) -> Path | None:
    """Where a package lies from which this process imports; None where there is none."""
    if package in sys.modules:
        file = sys.modules[package].__file__
        path = None if file is None else Path(file)
    else:
        beside = Path(__file__).parents[2] / package
        path = beside / "__init__.py"
    if path is None or not path.is_file():
        return None
    return path.parent if path.name == "__init__.py" else path


def content_hash(path: Path, scenario: str | None = None) -> str:
    """The hash of a file, or of all files below a directory and its base, with their names; "" for none.

    Of the files in ``scenarios/`` only that of ``scenario`` counts, where one is named.
    """
    if path.is_file():
        return _hash([(b"", path.read_bytes())])
    files = [
        (str(file.relative_to(directory)).encode(), file.read_bytes())
        for directory in layers(path)
        for file in sorted(directory.rglob("*"))
        if file.is_file() and _readable(file, scenario)
    ]
    return _hash(files) if files else ""


def _readable(file: Path, scenario: str | None) -> bool:
    return scenario is None or file.parent.name != _SCENARIOS or file.stem == scenario


def _hash(parts: Iterable[tuple[bytes, bytes]]) -> str:
    digest = hashlib.sha256()
    for name, content in parts:
        digest.update(b"%d %d\0" % (len(name), len(content)) + name + content)
    return digest.hexdigest()[:_DIGITS]


__all__ = ["Campaign", "CampaignRequest", "Run", "Task", "configuration_of", "evidence_of", "run_campaign"]


class CampaignRequest(NamedTuple):
    """What a campaign is asked for: ``runs`` from ``seed`` on, rows and pictures in ``out``.

    ``scheduler``: a Dask cluster that is there; else ``workers`` processes are started, or none. ``fresh``:
    no row is reused. ``json``, ``plot``: files to write figures and the first picture to.
    """

    config_dir: Path
    out: Path
    runs: int = 1
    seed: int = 1
    scheduler: str | None = None
    workers: int = 2
    fresh: bool = False
    json: Path | None = None
    plot: Path | None = None


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
    evidence = {scenario: evidence_of(function, scenario) for scenario in {_scenario(task) for task in tasks}}
    configurations = {str(task["key"]): configuration_of(evidence[_scenario(task)], task) for task in tasks}
    if len(configurations) != len(tasks):
        raise ConfigurationError("configuration.duplicate_task", f"{title}: two tasks have the same key")
    file = RowFile(directory / "rows.csv")
    kept = [] if request.fresh else [row for row in file.rows if _conclusive(row)]
    done = {(str(row["key"]), str(row["configuration"])): row for row in kept}
    to_do = [task for task in tasks if (str(task["key"]), configurations[str(task["key"])]) not in done]
    _note(
        directory,
        [
            {"configuration": configurations[str(task["key"])], "title": title, "task": task}
            | evidence[_scenario(task)]
            for task in tasks
        ],
    )
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


def evidence_of(function: Run, scenario: str | None = None) -> dict[str, Any]:
    """What a run depends on beside its task: sources, versions, and what is bound to ``function``.

    A bound path counts by its content; of a directory's scenarios only ``scenario``, where one is named.
    """
    bound: list[Any] = []
    whole: Any = function
    while isinstance(whole, partial):
        bound.append([*whole.args, *sorted(whole.keywords.items())])
        whole = whole.func

    def by_content(value: Any) -> Any:
        if isinstance(value, Path):
            return content_hash(value, scenario)
        return [by_content(item) for item in value] if isinstance(value, (list, tuple)) else plain(value)

    return {**provenance_of(function)._asdict(), "bound": by_content(bound)}


def _scenario(task: Task) -> str | None:
    named = task.get("scenario")
    return None if named is None else str(named)


def _on_same_evidence(function: Run, evidence: Mapping[str | None, Mapping[str, Any]], task: Task) -> Any:
    """The run, on a worker whose sources, files and libraries are those of the campaign's client."""
    wanted, here = evidence[_scenario(task)], evidence_of(function, _scenario(task))
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
