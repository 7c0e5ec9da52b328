"""Overload: named with the worst share of the last seconds, forgotten when it is over."""

import asyncio
import time
from pathlib import Path
from typing import NamedTuple

import pytest

from foundation import self_watch
from foundation.event_log import EventLog
from foundation.periods import Limit, OverloadWatch, Tally
from foundation.self_watch import SelfWatch

S = 1_000_000_000
LIMITS = {
    "scans": Limit(1.0, "of the scans were late"),
    "pictures": Limit(20.0, "of the pictures were skipped"),
}


def test_a_share_above_its_limit_is_told_with_its_figure() -> None:
    watch = OverloadWatch(LIMITS)
    assert watch.update(0, {"scans": Tally(1000, 500)}) == ""  # what was before the start says nothing
    assert watch.update(2 * S, {"scans": Tally(1390, 510)}) == (
        "the machine is overloaded: 2.5 % of the scans were late in the last 2 s"
    )


@pytest.mark.parametrize(("missed", "told"), [(4, False), (5, True)])
def test_both_sides_of_a_limit(missed: int, told: bool) -> None:
    watch = OverloadWatch(LIMITS)
    watch.update(0, {"scans": Tally(0, 0)})
    assert bool(watch.update(S, {"scans": Tally(400 - missed, missed)})) is told  # 1.0 %, 1.25 %


def test_it_is_over_when_five_seconds_were_good() -> None:
    watch = OverloadWatch(LIMITS)
    watch.update(0, {"scans": Tally(0, 0)})
    assert watch.update(S, {"scans": Tally(150, 50)})
    assert watch.update(5 * S, {"scans": Tally(950, 50)})
    assert watch.update(6 * S, {"scans": Tally(1150, 50)}) == "" == watch.warning


def test_counts_that_begin_anew_and_few_say_nothing() -> None:
    watch = OverloadWatch(LIMITS)
    watch.update(0, {"scans": Tally(1000, 100)})
    assert watch.update(S, {"scans": Tally(150, 0)}) == ""  # another process
    watch = OverloadWatch(LIMITS)
    watch.update(0, {})
    watch.update(S, {"scans": Tally(0, 0)})
    assert watch.update(2 * S, {"scans": Tally(1, 8)}) == ""


class _Disk(NamedTuple):
    free: float


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[EventLog, list[float]]:
    """A log that records on a disk whose free MB are in the list."""
    free_mb = [1000.0]
    log = EventLog("service")
    log.record_in(tmp_path)
    monkeypatch.setattr(self_watch.shutil, "disk_usage", lambda _: _Disk(free_mb[0] * 1e6))
    return log, free_mb


def test_a_disk_that_fills_is_told_and_ends_what_must_be_recorded(
    recorded: tuple[EventLog, list[float]], tmp_path: Path
) -> None:
    log, free_mb = recorded
    watch = SelfWatch(log, {}, dict, tmp_path)
    watch.look(0)
    assert log.healthy
    free_mb[0] = self_watch.DISK_LOW_MB - 1.0
    watch.look(S)
    assert log.healthy
    free_mb[0] = self_watch.DISK_FULL_MB - 1.0
    watch.look(2 * S)
    assert not log.healthy
    free_mb[0] = 1000.0
    watch.look(3 * S)
    assert log.healthy
    log.close()
    assert (tmp_path / "events.jsonl").read_text().count("recording.disk_low") == 2


def test_overload_and_its_end_are_events(recorded: tuple[EventLog, list[float]], tmp_path: Path) -> None:
    log, _ = recorded
    scans = [Tally(0, 0)]
    watch = SelfWatch(log, LIMITS, lambda: {"scans": scans[0]}, None)
    watch.look(0)
    scans[0] = Tally(100, 50)
    watch.look(S)
    assert watch.overload.startswith("the machine is overloaded: 33.3 % of the scans")
    scans[0] = Tally(1100, 50)
    watch.look(7 * S)
    assert watch.overload == ""
    scans[0] = Tally(1200, 100)
    watch.look(8 * S)
    watch.look(9 * S)
    log.close()
    events = (tmp_path / "events.jsonl").read_text()
    assert events.count("machine.overloaded") == 2  # at each beginning, not at each look
    assert events.count("overload_over") == 1


def test_a_standstill_without_a_processor_is_overload_for_five_seconds(
    recorded: tuple[EventLog, list[float]], tmp_path: Path
) -> None:
    log, _ = recorded
    watch = SelfWatch(log, LIMITS, dict, None)
    watch.look(0)
    watch.stood_still(S, 0.69, 0.05)
    assert watch.overload.endswith("service stood still for 0.69 s and had 0.05 s of a processor in it")
    for second in range(1, 7):
        watch.look(second * S)
        assert bool(watch.overload) is (second < 6)
    log.close()
    events = (tmp_path / "events.jsonl").read_text()
    assert events.count("machine.overloaded") == 1
    assert events.count("overload_over") == 1


def test_a_standstill_by_own_work_is_not_the_machines(
    recorded: tuple[EventLog, list[float]], tmp_path: Path
) -> None:
    log, _ = recorded
    watch = SelfWatch(log, LIMITS, dict, None)
    watch.stood_still(S, 0.69, 0.60)
    watch.look(S)
    assert watch.overload == ""
    log.close()
    assert "service.held_up" in (tmp_path / "events.jsonl").read_text()


async def test_a_loop_that_is_held_up_is_told(recorded: tuple[EventLog, list[float]], tmp_path: Path) -> None:
    log, _ = recorded
    watch = SelfWatch(log, {}, dict, None)
    watching = asyncio.create_task(watch.keep_looking())
    await asyncio.sleep(0)
    time.sleep(0.4)  # noqa: ASYNC251 - the loop must be held up
    await asyncio.sleep(0.1)
    watching.cancel()
    watch.look(time.monotonic_ns())
    log.close()
    assert "stood still" in (tmp_path / "events.jsonl").read_text()
