"""Pytest plugin: real-time tests run last, beside nothing that computes; a failed one is retried and counted.

A file marked ``long`` computes for seconds and is begun first: no process waits for another one at the end.

A test marked ``realtime`` talks over real sockets with deadlines; other work on the machine can make it
late. With ``realtime("processes")`` it starts real services, which need most of the machine. With ``-n 2``
all other tests run first, file by file, in both processes. Then the first process runs the tests with
services, one at a time, and the second those with sockets, which mostly wait. A real-time test that fails
is tried once more with new fixtures, and without what the first try left open. The first failure is printed,
and "N retried" stands in pytest's own closing line. A test without the mark is never tried again.
"""

import gc
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol
from _pytest.threadexception import thread_exceptions
from _pytest.unraisableexception import unraisable_exceptions
from xdist.scheduler import LoadScopeScheduling

MARK = "realtime"
LONG_MARK = "long"
RETRIED = "retried"
LONG, PURE, SOCKETS, PROCESSES = "0", "1", "2", "3"
HELD = 2  # so many tests of a file a process keeps back until it knows what comes next
_SECOND_TRY = pytest.StashKey[bool]()
_LIST_FILE = pytest.StashKey[Path]()


# the second try


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a real-time test, and once more if it failed; leave all others to pytest."""
    if item.get_closest_marker(MARK) is None or item.stash.get(_SECOND_TRY, False):
        return None
    hook = item.ihook
    hook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports = runtestprotocol(item, log=False, nextitem=nextitem)
    failed = [report for report in reports if report.failed]
    for report in failed[:1] or reports:
        if failed:
            report.outcome = RETRIED  # type: ignore[assignment]  # a category of its own, neither pass nor failure
        hook.pytest_runtest_logreport(report=report)
    if failed:
        item.session._setupstate.teardown_exact(None)  # fixtures of every scope are made anew
        item._initrequest()  # type: ignore[attr-defined]
        _forget_what_is_left_open(item.config)
        item.stash[_SECOND_TRY] = True
        hook.pytest_runtest_protocol(item=item, nextitem=nextitem)
    hook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _forget_what_is_left_open(config: pytest.Config) -> None:
    """Collect what a failed try left behind (sockets, threads), so that the next one is not judged by it."""
    for name in ("last_exc", "last_type", "last_value", "last_traceback"):
        if hasattr(sys, name):
            delattr(sys, name)  # they keep the frames of the failure, and all that these hold
    gc.collect()
    for left in (unraisable_exceptions, thread_exceptions):
        if left in config.stash:
            config.stash[left].clear()


def pytest_report_teststatus(
    report: pytest.TestReport,
) -> tuple[str, str, tuple[str, dict[str, bool]]] | None:
    """Category, letter and word of a first try that failed."""
    return (RETRIED, "R", ("RETRIED", {"yellow": True})) if report.outcome == RETRIED else None


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the names of the tests that were retried, with what failed the first time."""
    retried = terminalreporter.stats.get(RETRIED, [])
    if not retried:
        return
    terminalreporter.write_sep("=", f"{len(retried)} retried: {', '.join(r.nodeid for r in retried)}")
    for report in retried:
        terminalreporter.write_sep("_", f"first try of {report.nodeid} ({report.when})")
        terminalreporter.write_line(report.longreprtext)


# the order in two processes


class RealTimeLast(LoadScopeScheduling):
    """Files over all processes; when all are done, real processes in the first and sockets in the second."""

    def __init__(self, config: pytest.Config, log: Any) -> None:
        super().__init__(config, log)
        self._list_file = config.stash[_LIST_FILE]
        self._real_time: dict[str, str] | None = None

    def _split_scope(self, nodeid: str) -> str:
        if self._real_time is None:
            self._real_time = dict(json.loads(self._list_file.read_text()))
        return f"{self._real_time.get(nodeid, PURE)} {nodeid.split('::', 1)[0]}"

    def _next_scope(self, node: Any) -> str | None:
        """The file that ``node`` takes next; None while there is none for it."""
        if computing := self._queued(LONG) or self._queued(PURE):
            return computing
        others = [other for other in self.nodes if other is not node]
        if any(self._pending_of(self._computing(other)) > HELD for other in others):
            return None  # real time begins when nobody computes
        sockets, processes = self._queued(SOCKETS), self._queued(PROCESSES)
        return (processes or sockets) if node is self.nodes[0] else sockets

    def _queued(self, kind: str) -> str | None:
        return next((scope for scope in self.workqueue if scope.startswith(kind)), None)

    def _computing(self, node: Any) -> dict[str, dict[str, bool]]:
        work = self.assigned_work[node].items()
        return {scope: tests for scope, tests in work if scope.startswith((LONG, PURE))}

    def _assign_work_unit(self, node: Any) -> None:
        scope = self._next_scope(node)
        if scope is not None:
            self.workqueue.move_to_end(scope, last=False)
            super()._assign_work_unit(node)

    def _reschedule(self, node: Any) -> None:
        only_processes = all(scope.startswith(PROCESSES) for scope in self.workqueue) and bool(self.workqueue)
        if only_processes and node is not self.nodes[0] and not node.shutting_down:
            node.shutdown()  # what is left is for the first process alone
        else:
            super()._reschedule(node)

    def mark_test_complete(self, node: Any, item_index: int, duration: float = 0) -> None:
        """Note the end of a test; another process may have waited for it."""
        super().mark_test_complete(node, item_index, duration)
        for other in self.nodes:
            if other is not node:
                self._reschedule(other)

    def remove_node(self, node: Any) -> str | None:
        """Take a process off the list; another one may have waited for it."""
        crashed = super().remove_node(node)
        for other in self.nodes:
            self._reschedule(other)
        return crashed


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> RealTimeLast:
    """The scheduler of ``-n``, whatever ``--dist`` says."""
    return RealTimeLast(config, log)


def pytest_configure(config: pytest.Config) -> None:
    """Choose the file in which the processes name the real-time tests to the scheduler."""
    if not hasattr(config, "workerinput"):
        folder = tempfile.TemporaryDirectory(prefix="longreach-tests-")
        config.add_cleanup(folder.cleanup)
        config.stash[_LIST_FILE] = Path(folder.name) / "real_time.json"


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Tell a process the name of that file."""
    node.workerinput["real_time_list"] = str(node.config.stash[_LIST_FILE])


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Write which tests are in real time, and how; run them last without ``-n`` too."""
    items.sort(key=kind_of)
    workerinput = getattr(config, "workerinput", None)
    if workerinput is not None:
        path = Path(workerinput["real_time_list"])
        part = path.with_suffix(f".{workerinput['workerid']}")
        part.write_text(json.dumps({item.nodeid: kind_of(item) for item in items}))
        part.replace(path)


def kind_of(item: pytest.Item) -> str:
    """What a test's marks say: no real time, long or not, sockets, or processes."""
    mark = item.get_closest_marker(MARK)
    if mark is None:
        return PURE if item.get_closest_marker(LONG_MARK) is None else LONG
    return PROCESSES if "processes" in mark.args else SOCKETS
