"""Pytest plugin: at the end of a run, the time that each folder's tests took, and what is slow unsaid.

Another machine is slower, so nothing fails by the clock.
"""

from collections import defaultdict

import pytest

SLOW_S = 2.0


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print process-seconds and tests by folder, and the tests over 2 s that lack the mark ``slow``."""
    seconds: dict[str, float] = defaultdict(float)
    marked: set[str] = set()
    for report in (report for reports in terminalreporter.stats.values() for report in reports):
        if isinstance(report, pytest.TestReport):
            seconds[report.nodeid] += report.duration
            if "slow" in report.keywords:
                marked.add(report.nodeid)
    if seconds:
        terminalreporter.write_sep("=", "time by folder: process-seconds, tests")
    for folder, times in _by_folder(seconds):
        terminalreporter.write_line(f"{sum(times):8.1f} {len(times):6d}  {folder}")
    unmarked = {test: spent for test, spent in seconds.items() if spent > SLOW_S and test not in marked}
    if unmarked:
        terminalreporter.write_sep("=", f"over {SLOW_S:.0f} s, without the mark slow")
    for test, spent in sorted(unmarked.items(), key=lambda one: -one[1]):
        terminalreporter.write_line(f"{spent:8.1f}  {test}")


def _by_folder(seconds: dict[str, float]) -> list[tuple[str, list[float]]]:
    folders: dict[str, list[float]] = defaultdict(list)
    for test, spent in seconds.items():
        file = test.split("::", 1)[0]
        folders[file.rpartition("/")[0] or "."].append(spent)
    return sorted(folders.items(), key=lambda one: -sum(one[1]))
