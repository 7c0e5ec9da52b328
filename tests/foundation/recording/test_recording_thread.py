"""The recorder beside a loop: nothing waits for the disk, what is dropped is counted, failures are told."""

import threading
from contextlib import closing
from pathlib import Path

from mcap.reader import make_reader

from foundation.recording.mcap_file import Format, Topic
from foundation.recording.messages import WAITING_MAX, RecordingThread
from tests.foundation.recording.test_mcap_file import TOPICS, kept
from tests.plant_emulator.shell.test_recording import eventually

FORMAT = Format("longreach.Text", "jsonschema", b"{}", "json")


def test_what_is_put_is_on_the_disk_soon_and_whole_in_the_end(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    with closing(RecordingThread(path, TOPICS, {})) as recorder:
        recorder.put(0, "x", 1, 1)
        eventually(lambda: kept(path.read_bytes(), tmp_path / "copy.mcap") == [1])
        for number in range(2, 500):
            recorder.put(0, "x", number, number)
    assert recorder.written == 499
    with path.open("rb") as stream:
        assert [m.publish_time for _, _, m in make_reader(stream).iter_messages()] == list(range(1, 500))


def test_a_disk_that_hangs_drops_what_may_be_dropped(tmp_path: Path) -> None:
    hangs, goes_on = threading.Event(), threading.Event()

    def encode(message: str) -> bytes:
        hangs.set()
        goes_on.wait(30.0)
        return message.encode()

    path = tmp_path / "f.mcap"
    with closing(RecordingThread(path, (Topic("/a", FORMAT, encode),), {})) as recorder:
        try:
            recorder.put(0, "x", 0, 0)
            assert hangs.wait(30.0)
            for number in range(1, WAITING_MAX + 10):
                recorder.put(0, "x", number, number)
            recorder.put(0, "x", 9999, 9999, wanted=True)
            assert recorder.dropped == 9
        finally:
            goes_on.set()
    assert kept(path.read_bytes(), tmp_path / "copy.mcap") == [*range(WAITING_MAX + 1), 9999]


def test_what_cannot_be_encoded_ends_the_recording_and_keeps_the_rest(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    with closing(RecordingThread(path, (Topic("/a", FORMAT, str.encode),), {})) as recorder:
        recorder.put(0, "x", 1, 1)
        eventually(lambda: recorder.written == 1)
        eventually(lambda: kept(path.read_bytes(), tmp_path / "copy.mcap") == [1])
        recorder.put(0, 7, 2, 2)
        eventually(lambda: "TypeError" in recorder.failure)
        recorder.put(0, "y", 3, 3)
    assert kept(path.read_bytes(), tmp_path / "copy.mcap") == [1]
