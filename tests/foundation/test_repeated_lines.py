"""Of a flood the first line is written, then its count; nothing is lost and nothing fills a disk."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from foundation.event_log import LATEST_NS, SOONEST_NS, RepeatedLines

MS = 1_000_000


def test_a_kind_that_was_quiet_for_a_second_begins_anew() -> None:
    lines: RepeatedLines[str] = RepeatedLines()
    lines.put("timeout", "one", 0)
    lines.put("timeout", "two", 100 * MS)
    assert lines.put("timeout", "three", 100 * MS + SOONEST_NS) == 2, "it stands for the second too"
    assert lines.put("timeout", "four", 101 * MS + SOONEST_NS) == 0


def test_a_flood_is_told_ever_less_often_and_no_less_than_once_a_minute() -> None:
    lines: RepeatedLines[int] = RepeatedLines()
    told_ns = [now_ns for now_ns in range(0, 300 * SOONEST_NS, 5 * MS) if lines.put("a", 0, now_ns)
               or lines.due(now_ns)]  # fmt: skip
    between = [round((b - a) / SOONEST_NS) for a, b in itertools.pairwise(told_ns)]
    assert between == [1, 2, 4, 8, 16, 32, 60, 60, 60]
    assert LATEST_NS == 60 * SOONEST_NS


def test_kinds_that_are_over_are_forgotten() -> None:
    lines: RepeatedLines[str] = RepeatedLines()
    for kind in range(1000):
        lines.put(kind, "line", 0)
        lines.put(kind, "line", MS)
    assert len(lines.due(SOONEST_NS)) == 1000
    assert lines.due(4 * SOONEST_NS) == []
    assert lines._kinds == {}


@given(st.lists(st.tuples(st.integers(0, 3000), st.booleans()), max_size=200))
def test_every_line_is_counted_once(steps: list[tuple[int, bool]]) -> None:
    lines: RepeatedLines[int] = RepeatedLines()
    now_ns, put, told = 0, 0, 0
    for wait_ms, looks in steps:
        now_ns += wait_ms * MS
        put += 1
        told += lines.put("a", put, now_ns)
        told += sum(count for _, count in lines.due(now_ns)) if looks else 0
    rest = lines.rest()
    assert told + sum(count for _, count in rest) == put
    assert lines.rest() == []
