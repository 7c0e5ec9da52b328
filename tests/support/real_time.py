"""Pytest plugin: slow tests are begun first, tests in real time last; few of these may fail a first try.

A test marked ``realtime`` talks over real sockets with deadlines or starts real services; other work on the
machine can make it late. pytest-rerunfailures gives it, and no other test, a second try, and prints what
failed. More than three such tests in a run fail it.
"""

import gc
import sys
import warnings

import pytest

LIMIT = 3


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put slow files first and real time last, and give tests in real time their second try."""
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


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the tests that were retried."""
    if retried := _retried(terminalreporter):
        line = f"{len(retried)} retried, at most {LIMIT} may be: {', '.join(retried)}"
        terminalreporter.write_sep("=", line)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail a run in which more than ``LIMIT`` tests were retried."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and len(_retried(reporter)) > LIMIT and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def _retried(reporter: pytest.TerminalReporter) -> list[str]:
    return sorted({report.nodeid for report in reporter.stats.get("rerun", [])})
