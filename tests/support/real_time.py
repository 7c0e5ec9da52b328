"""Pytest plugin: real-time tests run last, in one process, and a failed one gets a second, counted try.

A test marked ``realtime`` talks over real sockets with deadlines, or to real processes; other work on the
machine can make it late. With ``-n 2`` all other tests run first, file by file, in both processes. Then one
process ends, and the other runs the real-time tests alone. A real-time test that fails is tried once more
with new fixtures. The first failure is printed, and "N retried" stands in pytest's own closing line. A test
without the mark is never tried again.
"""

import json
import tempfile
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol
from xdist.scheduler import LoadScopeScheduling

MARK = "realtime"
RETRIED = "retried"
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
        item.stash[_SECOND_TRY] = True
        hook.pytest_runtest_protocol(item=item, nextitem=nextitem)
    hook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


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
    """Files over all processes; then the real-time tests in one process alone."""

    def __init__(self, config: pytest.Config, log: Any) -> None:
        super().__init__(config, log)
        self._list_file = config.stash[_LIST_FILE]
        self._real_time: frozenset[str] | None = None

    def _split_scope(self, nodeid: str) -> str:
        if self._real_time is None:
            self._real_time = frozenset(json.loads(self._list_file.read_text()))
        return f"{nodeid in self._real_time:d} {nodeid.split('::', 1)[0]}"

    def _only_real_time_is_left(self) -> bool:
        return bool(self.workqueue) and all(scope.startswith("1") for scope in self.workqueue)

    def _assign_work_unit(self, node: Any) -> None:
        if self._only_real_time_is_left():
            if len(self.nodes) > 1:
                return  # _reschedule ends one process first
        else:
            self.workqueue.move_to_end(next(s for s in self.workqueue if s.startswith("0")), last=False)
        super()._assign_work_unit(node)

    def _reschedule(self, node: Any) -> None:
        if self._only_real_time_is_left() and not node.shutting_down:
            others = [other for other in self.nodes if other is not node]
            if any(not other.shutting_down for other in others):
                node.shutdown()
            if others:
                return
        super()._reschedule(node)

    def remove_node(self, node: Any) -> str | None:
        """Take a process off the list, and give its place to the one that waits for the machine."""
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
    """Write the names of the real-time tests; run them last without ``-n`` too."""
    items.sort(key=lambda item: item.get_closest_marker(MARK) is not None)
    workerinput = getattr(config, "workerinput", None)
    if workerinput is not None:
        path = Path(workerinput["real_time_list"])
        part = path.with_suffix(f".{workerinput['workerid']}")
        part.write_text(json.dumps([item.nodeid for item in items if item.get_closest_marker(MARK)]))
        part.replace(path)
