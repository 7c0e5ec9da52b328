"""A recording beside a loop: what is recorded is handed over, a thread of its own encodes and writes it."""

import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from foundation.recording.mcap_file import CHUNK_NS, Entries, McapFile, Topic
from foundation.scheduling import take_fifo

_Item = tuple[int, Any, int, int]
# [D] At 60 messages a second a disk may hang for half a minute before one is lost.
WAITING_MAX = 2000
_CLOSE_S = 10.0
_BELOW_ALL = 1  # of FIFO priorities
_SWITCH_S = 0.0001  # how long the thread keeps the loop from the interpreter; Python's own are 5 ms


class RecordSink(Protocol):
    """Where messages of known topics go: to a thread, or into the file at once."""

    path: Path
    failure: str
    dropped: int

    @property
    def written(self) -> int:
        """How many messages were taken into the file."""
        ...

    def wants(self, topic: int) -> bool:
        """Whether a message of topic number ``topic`` is of use to anybody."""
        ...

    def put(self, topic: int, message: Any, log_ns: int, publish_ns: int, *, wanted: bool = False) -> None:
        """Record ``message`` on topic number ``topic``; never drop what is ``wanted``."""
        ...

    def close(self) -> None:
        """Write what waits and the summary, and close the file."""
        ...


class DirectRecording:
    """Records at once, for simulated time: the same file from the same run. Raises OSError of a full disk."""

    failure = ""
    dropped = 0

    def __init__(self, path: Path, topics: Sequence[Topic], metadata: Entries) -> None:
        """Create ``path``. Raises FileExistsError where it exists, OSError when it cannot be written."""
        self.path = path
        self._file = McapFile(path, topics, metadata)

    @property
    def written(self) -> int:
        """How many messages were taken into the file."""
        return self._file.messages

    def wants(self, topic: int) -> bool:
        """Always."""
        return True

    def put(self, topic: int, message: Any, log_ns: int, publish_ns: int, *, wanted: bool = False) -> None:
        """Record ``message`` on topic number ``topic``."""
        self._file.add(topic, message, log_ns, publish_ns)

    def close(self) -> None:
        """Write the summary and close the file."""
        self._file.close()


class RecordingThread:
    """Records in a thread of its own; ``put`` takes some microseconds and waits for nothing.

    What is put must not change afterwards. ``dropped``: messages that found ``WAITING_MAX`` others waiting;
    those put with ``wanted`` are never dropped. ``failure``: why nothing more can be written, such as a full
    disk; empty while all is well. What was put reaches the operating system within half a second.
    """

    def __init__(
        self,
        path: Path,
        topics: Sequence[Topic],
        metadata: Entries,
        fifo_priority: int = 0,
        tap: Callable[[int, bytes, int], None] | None = None,
    ) -> None:
        """Create ``path``. ``fifo_priority``: of the loop, 0 where it asks for none. ``tap`` is called with
        topic, encoded message and its time once it is taken into the file, in the recording's thread.

        The thread takes the lowest where the loop has one: while it has the interpreter, which the loop waits
        for, no ordinary process may put it aside. Raises FileExistsError where it exists, OSError when it
        cannot be written.
        """
        self.path = path
        self.dropped = 0
        self.failure = ""
        self._file = McapFile(path, topics, metadata)
        self._tap = tap
        self._fifo_priority = min(fifo_priority, _BELOW_ALL)
        self._items: queue.SimpleQueue[_Item | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write_items, name=f"record-{path.name}", daemon=True)
        sys.setswitchinterval(_SWITCH_S)
        self._thread.start()

    @property
    def written(self) -> int:
        """How many messages were taken into the file."""
        return self._file.messages

    def wants(self, topic: int) -> bool:
        """Always."""
        return True

    def put(self, topic: int, message: Any, log_ns: int, publish_ns: int, *, wanted: bool = False) -> None:
        """Record ``message`` on topic number ``topic``."""
        if self.failure:
            return
        if not wanted and self._items.qsize() >= WAITING_MAX:
            self.dropped += 1
            return
        self._items.put((topic, message, log_ns, publish_ns))

    def close(self) -> None:
        """Write what waits and the summary, and close the file. What can no longer be written is left out."""
        self._items.put(None)
        self._thread.join(_CLOSE_S)

    def _write_items(self) -> None:
        take_fifo(self._fifo_priority)
        try:
            self._keep_writing()
            self._file.close()
        except Exception as error:  # also what cannot be encoded ends the recording, never the service
            self.failure = getattr(error, "strerror", None) or repr(error)
            self._file.abandon()

    def _keep_writing(self) -> None:
        """Write until asked to end: a chunk is closed by the time of its messages, or when no more come."""
        period_s = 1e-9 * CHUNK_NS
        due_s = time.monotonic() + period_s
        while True:
            try:
                item = self._items.get(timeout=max(due_s - time.monotonic(), 0.0))
            except queue.Empty:
                self._file.flush()
                due_s = time.monotonic() + period_s
                continue
            if item is None:
                return
            data = self._file.add(*item)
            if self._tap is not None:
                self._tap(item[0], data, item[2])
