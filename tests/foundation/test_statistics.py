"""The statistics file: whole at any time, signed with its service; a disk that fails is logged."""

import asyncio
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from foundation.self_watch import StatisticsFile, resident_mb
from tests.support.log_lines import HeardLog


@pytest.fixture
def log() -> HeardLog:
    return HeardLog("controller")


def test_the_service_signs_what_it_writes(log: HeardLog, tmp_path: Path) -> None:
    path = tmp_path / "made" / "statistics.json"
    StatisticsFile(path, "controller", log, lambda: {"cycles": 3}).write()
    log.close()
    assert json.loads(path.read_text()) == {"service": "controller", "cycles": 3, "log_lines_dropped": 0}
    assert os.listdir(path.parent) == ["statistics.json"]


def test_a_reader_never_sees_half_a_file(log: HeardLog, tmp_path: Path) -> None:
    path = tmp_path / "statistics.json"
    file = StatisticsFile(path, "plant_emulator", log, lambda: {"much": list(range(20_000))})
    file.write()
    done = threading.Event()

    def keep_writing() -> None:
        while not done.is_set():
            file.write()

    writer = threading.Thread(target=keep_writing)
    writer.start()
    try:
        for _ in range(200):
            assert len(json.loads(path.read_text())["much"]) == 20_000
    finally:
        done.set()
        writer.join()
        log.close()


async def test_a_disk_that_hangs_does_not_hold_the_loop(
    log: HeardLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hangs, goes_on = threading.Event(), threading.Event()
    stood_still = threading.Event()

    def hang(_self: Path, _text: str, encoding: str) -> int:
        hangs.set()
        if not goes_on.wait(60.0):
            stood_still.set()
        return 0

    monkeypatch.setattr("foundation.self_watch._PERIOD_S", 0.0)
    monkeypatch.setattr(Path, "write_text", hang)
    file = StatisticsFile(tmp_path / "statistics.json", "vision_pc", log, dict)
    writing = asyncio.create_task(file.keep_writing())
    try:
        assert await asyncio.to_thread(hangs.wait, 60.0)
    finally:
        goes_on.set()
        writing.cancel()
        await asyncio.gather(writing, return_exceptions=True)
        log.close()
    assert not stood_still.is_set(), "the loop waited for the disk"


def test_a_disk_that_fails_later_is_logged_and_leaves_the_old_file(log: HeardLog, tmp_path: Path) -> None:
    path = tmp_path / "statistics.json"
    file = StatisticsFile(path, "vision_pc", log, lambda: {"n": 1})
    file.write()
    before = path.read_text()
    (tmp_path / "statistics.json.part").mkdir()
    file.write()
    log.close()
    assert path.read_text() == before
    (line,) = log.lines()
    assert (line["event"], line["level"], line["cause"]) == (
        "statistics_failed", "error", "statistics.unwritable"
    )  # fmt: skip


def test_resident_memory_of_this_process_of_another_and_of_one_that_has_gone() -> None:
    assert resident_mb() > 10.0
    command = [sys.executable, "-c", "print(flush=True); input()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        assert 1.0 < resident_mb(other.pid) < 200.0
        other.communicate(b"end\n")
    assert resident_mb(other.pid) == 0.0
