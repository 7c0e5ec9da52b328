"""Pytest plugin: slow tests are begun first, those in real time last; few of these may fail a first try.

A test marked ``processes`` starts services by the plant's clock: nothing is late there, and none is retried.
One marked ``realtime`` talks over real sockets with deadlines by the wall; other work on the machine can make
it late. pytest-rerunfailures gives it, and no other test, a second try, and prints what
failed. More than three such tests fail a run; runs that share the file LONGREACH_RETRIED share the three.
What was deselected is named at the end, with the command that runs it.
"""

import gc
import os
import sys
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

LIMIT = 3
RETRIED = "LONGREACH_RETRIED"
RUN_BY = {
    "bench": "make bench",
    "docker": "make compose-test",
    "experiment": "make experiments",
    "realtime": "alone, after these",
}
_deselected: Counter[str] = Counter()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put slow files first and real time last, and give tests in real time their second try.

    Services by the plant's clock go beside anything: last, they would keep one worker alone for minutes.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (_in_real_time(item), item.path not in slow))
    for item in items:
        if _in_real_time(item):
            item.add_marker(pytest.mark.flaky(reruns=1))


def _in_real_time(item: pytest.Item) -> bool:
    return item.get_closest_marker("realtime") is not None


def pytest_runtest_logfinish() -> None:
    """Close what a failed try left open, so that what runs next is not judged by it."""
    if not hasattr(sys, "last_traceback"):
        return
    for name in ("last_exc", "last_type", "last_value", "last_traceback"):
        sys.__dict__.pop(name, None)  # they keep the frames of the failure, and all that these hold
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


def pytest_deselected(items: list[pytest.Item]) -> None:
    """Count them by mark."""
    for item in items:
        marks = [mark for mark in RUN_BY if item.get_closest_marker(mark) is not None]
        _deselected[marks[0] if marks else "others"] += 1


class OfWorkers:
    """pytest-xdist's workers say what they deselected: each the same."""

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any, error: object) -> None:
        _deselected.update({} if _deselected else getattr(node, "workeroutput", {}).get("deselected", {}))


def pytest_configure(config: pytest.Config) -> None:
    """Hear the workers, where there are some."""
    config.pluginmanager.register(OfWorkers())


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the tests that were retried, and what was not run."""
    if retried := _retried(terminalreporter):
        line = f"{len(retried)} retried, at most {LIMIT} may be: {', '.join(retried)}"
        terminalreporter.write_sep("=", line)
    for mark, count in sorted(_deselected.items()):
        terminalreporter.write_line(f"deselected: {count} {mark} ({RUN_BY.get(mark, 'as asked')})")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a run in which, with those that it shares a file with, more than ``LIMIT`` tests were retried."""
    output = getattr(session.config, "workeroutput", None)
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if output is not None:
        output["deselected"] = dict(_deselected)
    elif reporter is not None:
        retried = [*_retried_before(), *_retried(reporter)]
        if RETRIED in os.environ:
            Path(os.environ[RETRIED]).write_text("".join(f"{test}\n" for test in retried))
        if len(retried) > LIMIT and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED


def _retried_before() -> list[str]:
    path = Path(os.environ.get(RETRIED, os.devnull))
    return path.read_text().splitlines() if path.exists() else []


def _retried(reporter: pytest.TerminalReporter) -> list[str]:
    return sorted({report.nodeid for report in reporter.stats.get("rerun", [])})
