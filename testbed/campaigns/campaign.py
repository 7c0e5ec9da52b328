"""Many runs of one function over Dask's workers: resumable, one row a run, a failure never a zero.

By default the workers are processes of this machine, started for the campaign; with ``scheduler`` they are
those of a Dask cluster that is already there, whose workers have Longreach installed. With no ``workers`` at
all the runs are made in this process, one after the other.
"""

import hashlib
import json
import logging
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import dask
import distributed as untyped
import numba
from distributed.client import FuturesCancelledError
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.comm.core import CommClosedError
from distributed.scheduler import KilledWorker

from protocol.errors import ConfigurationError, LinkLost, LongreachError
from testbed.campaigns.provenance import content_hash, provenance_of
from testbed.campaigns.row_file import Row, RowFile
from testbed.campaigns.typed_rows import flat
from testbed.reporting.console import bars, out, plain
from testbed.reporting.ctrl_c import kept_on_ctrl_c

distributed: Any = untyped  # it has types in part only

Task = dict[str, Any]
Run = Callable[[Task], Any]
"""A task to its row: flat, or a NamedTuple."""

REACH_S = 3.0  # a scheduler that does not answer by then is not there
_WORKERS_S = 20.0  # for the first worker of a scheduler to be there
_MEMORY_LIMIT = "4GiB"  # of one embedded worker; beyond it is ended, and the run begun again
_WORN_BYTES = 3 << 29  # of an embedded worker between two runs; beyond it, a new one takes over
_PATIENCE_S = 60.0  # without a result until somebody asks whether anyone is working
_RESTART_S = 600.0  # a worker that has not restarted by then stays away for the rest of the campaign
_AGAIN = "campaign."  # causes that say nothing about the run itself: a resumed campaign tries it again
_QUIET = {
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,  # a paused worker would wait for ever: its memory is one run's
    "distributed.scheduler.allowed-failures": 1,  # a run that ends its worker twice would do so again
    "distributed.scheduler.worker-ttl": None,  # compiled kernels may keep a worker from answering for long
    "distributed.comm.timeouts.connect": "120s",  # on a busy machine a worker takes its time to start
    "distributed.admin.large-graph-warning-threshold": "1GiB",
}


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
            for task, row in _results(checked, to_do, request.scheduler, workers, title):
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
        raise LinkLost(
            f"{_AGAIN}other_worker", f"the worker's {', '.join(other)} are not those of the client"
        )
    return function(task)


def _conclusive(row: Row) -> bool:
    return not str(row.get("failure") or "").startswith(_AGAIN)


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


class _Done(NamedTuple):
    row: Row
    worker: str
    memory: int  # bytes that the worker's process holds after the run


def _run_on_worker(function: Run, task: Task) -> _Done:
    row, worker = _run(function, task), distributed.get_worker()
    return _Done(row, worker.address, worker.monitor.get_process_memory())


def _run(function: Run, task: Task) -> Row:
    """One run; whatever it raises becomes its row's failure."""
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    began, cpu_s = time.perf_counter(), time.process_time()
    row: Row
    try:
        row = {"failure": "", **flat(function(task))}
    except LongreachError as error:
        row = {"failure": f"{error.cause}: {error}"}
    except Exception as error:
        row = {"failure": f"{_AGAIN}exception: {type(error).__name__}: {error}"}
    times = {"run_s": time.perf_counter() - began, "cpu_s": time.process_time() - cpu_s}
    return row | {name: round(value, 3) for name, value in times.items()}


class _Workforce(NamedTuple):
    client: Any
    places: int  # runs at once
    ours: bool  # whether the workers were started here, and may be replaced


def _results(
    function: Run, tasks: Sequence[Task], scheduler: str | None, workers: int, title: str
) -> Iterator[tuple[Task, Row]]:
    """Each task with its row, as they are done."""
    if scheduler is None and workers == 0:
        made: Generator[tuple[Task, Row], None, None] = ((task, _run(function, task)) for task in tasks)
    else:
        made = _distributed(function, tasks, scheduler, workers)
    spent: list[float] = []
    failed = 0
    with bars() as shown, shown.step(title) as bar, closing(made):
        for task, row in made:
            spent.append(row.get("run_s") or 0.0)
            failed += bool(row["failure"])
            mean_s = sum(spent) / len(spent)
            note = f"{len(spent)} of {len(tasks)}, {mean_s:.1f} s a run, {failed} failed"
            bar.update(len(spent) / len(tasks), note)
            yield task, row


def _distributed(
    function: Run, tasks: Sequence[Task], scheduler: str | None, workers: int
) -> Generator[tuple[Task, Row], None, None]:
    with _workforce(scheduler, workers) as force:
        waiting = iter(tasks)
        under_way: dict[Any, Task] = {}

        def start(count: int) -> None:
            for task in islice(waiting, count):
                under_way[force.client.submit(_run_on_worker, function, task, pure=False)] = task

        start(force.places)
        while under_way:
            future = _first_done(force.client, list(under_way))
            task = under_way.pop(future)
            done = _outcome(future)
            if force.ours and done.memory > _WORN_BYTES:
                force.client.restart_workers([done.worker], timeout=_RESTART_S, raise_for_error=False)
            start(1)
            yield task, done.row


def _first_done(client: Any, futures: Sequence[Any]) -> Any:
    """The first of ``futures`` that has ended, however. Raises LinkLost when nobody works on them."""
    while True:
        ended = [future for future in futures if future.status != "pending"]
        if ended:
            return ended[0]
        try:
            with client.as_current():
                distributed.wait(futures, timeout=_PATIENCE_S, return_when="FIRST_COMPLETED")
        except (TimeoutError, FuturesCancelledError):  # cancelled: the loop above sees which
            if not client.scheduler_info(n_workers=-1)["workers"]:
                why = "no worker is left; the rows done until then are kept"
                raise LinkLost("link.workers_lost", why) from None


def _outcome(future: Any) -> _Done:
    """What a finished future holds. Raises LinkLost when its scheduler has gone away."""
    if future.status in ("cancelled", "lost"):
        raise LinkLost("link.scheduler_lost", "the scheduler went away; the rows done until then are kept")
    try:
        done: _Done = future.result(timeout=REACH_S)
    except KilledWorker as error:
        return _Done({"failure": f"{_AGAIN}worker_lost: {error}"}, "", 0)
    except (OSError, CommClosedError) as error:
        raise LinkLost("link.scheduler_lost", f"the scheduler went away: {error}") from error
    return done


@contextmanager
def _workforce(scheduler: str | None, workers: int) -> Iterator[_Workforce]:
    """Workers that are there, with a client of their scheduler; those started here are ended again."""
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(_QUIET))
        if scheduler is None:
            cluster = stack.enter_context(_started(workers))
            client = stack.enter_context(distributed.Client(cluster, set_as_default=False))
            client.register_plugin(_IgnoresCtrlC())  # for those that replace worn ones
            yield _Workforce(client, workers, True)
        else:
            client = stack.enter_context(_reached(scheduler))
            yield _Workforce(client, 2 * sum(client.nthreads().values()), False)


class _IgnoresCtrlC(distributed.WorkerPlugin):  # type: ignore[misc]
    """A worker leaves Ctrl-C to its client, which ends it in order."""

    def setup(self, worker: Any) -> None:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _ctrl_c_ignored() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _started(workers: int) -> Iterator[Any]:
    """A cluster of worker processes on loopback. Raises LinkLost (``link.workers_not_started``)."""
    try:
        with _ctrl_c_ignored():  # workers inherit it: the client alone acts on Ctrl-C
            cluster = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                scheduler_kwargs={"dashboard": False},
                memory_limit=_MEMORY_LIMIT,
                silence_logs=logging.CRITICAL,
            )
    except (OSError, RuntimeError) as error:
        raise LinkLost(
            "link.workers_not_started", f"{workers} workers could not be started: {error}"
        ) from error
    try:
        yield cluster
    finally:
        with suppress(TimeoutError):  # a worker that will not end does so with this process
            cluster.close()


@contextmanager
def _reached(scheduler: str) -> Iterator[Any]:
    """A client of the scheduler at ``scheduler``, which has at least one worker."""
    try:
        parse_host_port(parse_address(scheduler, strict=True)[1])  # before a client is made that cannot be
        client = distributed.Client(scheduler, timeout=REACH_S, set_as_default=False)
    except ValueError as error:
        raise ConfigurationError(
            "configuration.bad_address", f"scheduler '{scheduler}': {error}; wanted such as tcp://host:8786"
        ) from error
    except OSError as error:
        raise LinkLost(
            "link.scheduler_unreachable", f"scheduler {scheduler} does not answer within {REACH_S:g} s"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_WORKERS_S)
        except TimeoutError as error:
            raise LinkLost(
                "link.scheduler_without_workers",
                f"scheduler {scheduler} has no worker after {_WORKERS_S:g} s",
            ) from error
        yield client
