"""One schema a line, on stderr and on record; no hanging reader and no full disk ends a service."""

import io
import json
import logging
import os
import threading
import time
import warnings
from pathlib import Path

import pytest

from foundation.event_log import MEMBERS, EventLog, in_words, process_log
from tests.support.log_lines import HeardLog, assert_obeys


class HangingReader(io.StringIO):
    """Takes nothing until it is released."""

    def __init__(self) -> None:
        super().__init__()
        self.released = threading.Event()

    def write(self, text: str) -> int:
        self.released.wait()
        return super().write(text)


def test_a_line_has_the_members_of_every_line_then_its_own() -> None:
    log = HeardLog("controller")
    before_ns = time.monotonic_ns()
    log.write("fault", "error", cause="PLANT_LINK_LOST", path=Path("a/b"))
    (line,) = log.lines()
    log.close()
    assert_obeys(line, "controller")
    assert tuple(line) == (*MEMBERS, "cause", "path")
    assert (line["event"], line["level"], line["cause"], line["path"]) == (
        "fault", "error", "PLANT_LINK_LOST", "a/b"
    )  # fmt: skip
    assert before_ns <= line["time_ns"] <= time.monotonic_ns()


@pytest.mark.parametrize("member", MEMBERS)
def test_no_field_may_take_the_place_of_a_member(member: str) -> None:
    log = EventLog("vision_pc", io.StringIO())
    with pytest.raises(ValueError, match=member):
        log.write("look", **{member: 1})
    log.close()


def test_a_hanging_reader_costs_lines_that_are_counted_and_no_time() -> None:
    reader = HangingReader()
    log = HeardLog("controller", reader)
    for number in range(5000):
        log.write("noise", number=number)  # waits for nobody: the reader is released after it
    assert log.dropped >= 5000 - 2002
    reader.released.set()
    assert len(log.lines()) + log.dropped == 5000
    log.close()


def test_repetitions_are_counted_in_a_line_that_comes_by_itself(tmp_path: Path) -> None:
    log = HeardLog("controller")
    log.record_in(tmp_path)
    for number in range(1, 101):
        log.write_repeated("ENABLE", "command", request=number)
    log.write_repeated("STOP", "command", request=101)
    assert [line["request"] for line in log.lines()] == [1, 101], "no stop waits behind a flood"
    deadline = time.monotonic() + 10.0
    while len(lines := log.lines()) < 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert_obeys(lines[2], "controller")
    assert (lines[2]["request"], lines[2]["repeated"]) == (100, 99)
    assert "repeated" not in lines[0]
    assert lines[2]["time_ns"] < lines[1]["time_ns"], "the time at which the last of them happened"
    log.write_repeated("ENABLE", "command", request=102)
    log.write_repeated("ENABLE", "command", request=103)
    log.close()
    assert log.lines()[-1]["request"] == 103, "what waits is not lost"
    assert (tmp_path / "events.jsonl").read_text() == log.text()


def test_a_closed_pipe_is_counted_and_nothing_else() -> None:
    stream = io.StringIO()
    log = EventLog("controller", stream)
    stream.close()
    log.write("something")
    log.flush()
    assert log.dropped == 1
    log.close()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_ends_the_recording_once_and_not_the_log(tmp_path: Path) -> None:
    (tmp_path / "events.jsonl").symlink_to("/dev/full")
    log = HeardLog("vision_pc")
    log.record_in(tmp_path)
    log.write("first")
    log.write("second")
    lines = log.lines()
    assert not log.healthy
    log.close()
    assert [line["event"] for line in lines] == ["first", "recording_failed", "second"]
    assert lines[1]["cause"] == "recording.unwritable"
    for line in lines:
        assert_obeys(line, "vision_pc")


def test_what_libraries_log_obeys_the_schema(capsys: pytest.CaptureFixture[str]) -> None:
    with process_log("plant_emulator"):
        logging.getLogger("pymodbus.logging").warning("frame %d refused", 7)
        logging.getLogger("uvicorn.error").info("started")
        try:
            raise KeyError("missing")
        except KeyError:
            logging.getLogger("asyncio").exception("a task broke")
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("old name", DeprecationWarning, stacklevel=1)
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [(line["event"], line["level"], line["logger"]) for line in lines] == [
        ("library", "warning", "pymodbus.logging"),
        ("library", "error", "asyncio"),
        ("library", "warning", "py.warnings"),
    ]
    assert lines[0]["message"] == "frame 7 refused"
    assert "KeyError: 'missing'" in lines[1]["exception"]
    assert "old name" in lines[2]["message"]
    for line in lines:
        assert_obeys(line, "plant_emulator")


def test_a_bug_is_a_line_with_its_traceback_and_status_1(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, process_log("controller"):
        raise ZeroDivisionError("a bug")
    assert ended.value.code == 1
    (line,) = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert_obeys(line, "controller")
    assert line["event"] == "broken"
    assert "test_event_log.py" in line["exception"]
    assert in_words(json.dumps(line)) == "internal: ZeroDivisionError('a bug')"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('{"event": "stopped"}', "stopped"),
        ('{"event": "stopped", "cause": "link.renderer_ended", "detail": "it ended"}',
         "link.renderer_ended: it ended"),
        ('{"event": "library", "logger": "asyncio", "message": "a task broke"}', "library: a task broke"),
        ("controller: configuration.port_busy: taken", "controller: configuration.port_busy: taken"),
        ("[1, 2]", "[1, 2]"),
        ("", ""),
    ],
)  # fmt: skip
def test_a_line_in_words(line: str, words: str) -> None:
    assert in_words(line) == words
