"""Room on the disk: told where it ends, and in the log's ``room``."""

from pathlib import Path
from typing import NamedTuple

import pytest

from foundation import self_watch
from foundation.event_log import EventLog
from foundation.self_watch import DiskWatch


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
    watch = DiskWatch(log, tmp_path)
    watch.look(tmp_path)
    assert log.healthy
    free_mb[0] = self_watch.DISK_LOW_MB - 1.0
    watch.look(tmp_path)
    assert log.healthy
    free_mb[0] = self_watch.DISK_FULL_MB - 1.0
    watch.look(tmp_path)
    assert not log.healthy
    free_mb[0] = 1000.0
    watch.look(tmp_path)
    assert log.healthy
    log.close()
    assert (tmp_path / "events.jsonl").read_text().count("recording.disk_low") == 2
