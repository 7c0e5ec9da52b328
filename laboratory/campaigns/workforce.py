"""Who makes a campaign's runs: this process, worker processes that are started for it, or a Dask cluster."""

import logging
import signal
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import cv2
import dask
import distributed as untyped
import numba
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.scheduler import KilledWorker

from laboratory.campaigns.rows import Row
from protocol.errors import ConfigurationError, LinkLost, LongreachError
from testbed.reporting.console import bars

distributed: Any = untyped  # it has types in part only

Task = dict[str, Any]
Run = Callable[[Path, Task], Row]
"""A configuration directory and a task to its row."""

AGAIN = "campaign."
"""Begins the causes that say nothing about the run itself: a resumed campaign tries it again."""

REACH_S = 3.0  # a scheduler that does not answer by then is not there
_MEMORY_LIMIT = "4GiB"  # of one embedded worker; beyond it is ended, and the run begun again
SPAWN_ENVIRONMENT = {
    "OMP_NUM_THREADS": 1,
    "OPENBLAS_NUM_THREADS": 1,
    "MKL_NUM_THREADS": 1,
    "MALLOC_TRIM_THRESHOLD_": 1 << 28,
    "MALLOC_MMAP_THRESHOLD_": 1 << 28,
}
"""Of a worker: the memory of its pictures is kept. Dask's own gives it back, and each is mapped anew."""
_QUIET = {
    "distributed.nanny.pre-spawn-environ": SPAWN_ENVIRONMENT,
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,  # a paused worker would wait for ever: its memory is one run's
    "distributed.scheduler.worker-saturation": 1.0,  # no run waits on a worker that another one may end
    "distributed.scheduler.allowed-failures": 1,  # a run that ends its worker twice would do so again
    "distributed.scheduler.worker-ttl": None,  # compiled kernels may keep a worker from answering for long
    "distributed.comm.timeouts.connect": "120s",  # on a busy machine a worker takes its time to start
    "distributed.admin.large-graph-warning-threshold": "1GiB",
}


def _run(function: Callable[[Task], Row], task: Task) -> Row:
    """One run; whatever it raises becomes its row's failure."""
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    began, cpu_s = time.perf_counter(), time.process_time()
    row: Row
    try:
        row = {"failure": "", **function(task)}
    except LongreachError as error:
        row = {"failure": f"{error.cause}: {error}"}
    except Exception as error:
        row = {"failure": f"{AGAIN}exception: {type(error).__name__}: {error}"}
    times = {"run_s": time.perf_counter() - began, "cpu_s": time.process_time() - cpu_s}
    return row | {name: round(value, 3) for name, value in times.items()}


def results(
    function: Callable[[Task], Row], tasks: Sequence[Task], scheduler: str | None, workers: int, title: str
) -> Iterator[tuple[Task, Row]]:
    """Each task with its row, as they are done, under a bar called ``title``.

    With ``scheduler`` the runs go to its cluster; else to ``workers`` processes, or none: they are made here.
    Raises LinkLost when no scheduler is there or it has gone, ConfigurationError for a malformed address.
    """
    made = ((task, _run(function, task)) for task in tasks)
    if scheduler is not None or workers:
        made = _distribute(function, tasks, scheduler, workers)
    spent_s, failed = 0.0, 0
    with bars() as shown, shown.step(title) as bar, closing(made):
        for done, (task, row) in enumerate(made, 1):
            spent_s += row.get("run_s") or 0.0
            failed += bool(row["failure"])
            note = f"{done} of {len(tasks)}, {spent_s / done:.1f} s a run, {failed} failed"
            bar.update(done / len(tasks), note)
            yield task, row


def _distribute(
    function: Callable[[Task], Row], tasks: Sequence[Task], scheduler: str | None, workers: int
) -> Generator[tuple[Task, Row], None, None]:
    with dask.config.set(_QUIET), _client(scheduler, workers) as client:
        futures = client.map(partial(_run, function), tasks, pure=False)
        task_of = dict(zip(futures, tasks, strict=True))
        for future in distributed.as_completed(futures, loop=client.loop):
            yield task_of[future], _outcome(future)


def _outcome(future: Any) -> Row:
    """What a finished future holds. Raises LinkLost when its scheduler has gone away."""
    try:
        row: Row = future.result()
    except KilledWorker as error:
        return {"failure": f"{AGAIN}worker_lost: {error}"}
    except (distributed.CancelledError, OSError) as error:
        why = "the scheduler went away; the rows done until then are kept"
        raise LinkLost("link.scheduler_lost", why) from error
    return row


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Ctrl-C takes effect after the block; threads and processes begun in it never hear of it."""
    resource_tracker.ensure_running()  # else the first of the processes does so, and lets Ctrl-C in
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _client(scheduler: str | None, workers: int) -> Iterator[Any]:
    """A client of the scheduler; where none is named, of ``workers`` on loopback that are ended with it.

    Raises as ``_client_of``.
    """
    if scheduler is not None:
        with _client_of(scheduler) as client:
            yield client
        return
    with _ctrl_c_held_back():  # workers inherit it: the client alone acts on Ctrl-C
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
    try:
        with distributed.Client(cluster, set_as_default=False) as client:
            yield client
    finally:
        with suppress(TimeoutError):  # a worker that will not end does so with this process
            cluster.close()


def _client_of(scheduler: str) -> Any:
    """A client of the scheduler at ``scheduler``; its runs wait until it has a worker."""
    try:
        parse_host_port(parse_address(scheduler, strict=True)[1])  # before a client is made that cannot be
        return distributed.Client(scheduler, timeout=REACH_S, set_as_default=False)
    except ValueError as error:
        raise ConfigurationError(
            "configuration.bad_address", f"scheduler '{scheduler}': {error}; wanted such as tcp://host:8786"
        ) from error
    except OSError as error:
        raise LinkLost(
            "link.scheduler_unreachable", f"scheduler {scheduler} does not answer within {REACH_S:g} s"
        ) from error
