"""A service's feed of the live view, where its environment names one."""

import contextlib
import json
import os
import select
import socket
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from foundation.event_log import EventLog
from foundation.live import wire
from foundation.live.wire import FEEDS_VARIABLE, LatestQueue
from foundation.periods import take_fifo
from foundation.recording.mcap_file import Entries, Topic
from foundation.recording.messages import RecordingThread, RecordSink
from foundation.recording.recorder import OpenSink

_NOBODY: frozenset[int] = frozenset()
_RETRY_S = 1.0
_TELL_AFTER = 10  # connections that failed
_CLOSE_S = 2.0
_NOT_ENCODED = 1 << 18  # [D] counts as so many bytes: it may hold on to a picture
_SWITCH_S = 0.0001  # as of the recording's thread
_Message = tuple[Any, int, bool]  # what, when, whether it is encoded already


class LiveFeed:
    """Feeds the live view. ``offer`` takes a microsecond and waits for nothing.

    Of topics that nobody wants nothing is kept, but the newest of those that are sent once. ``dropped``:
    messages that made room for newer ones. It is a recorder's sink too, which keeps no file.
    """

    path = Path()
    failure = ""
    written = 0

    def __init__(
        self, service: str, log: EventLog, feeds: str, metrics: Callable[[], str], fifo_priority: int = 0
    ) -> None:
        """``metrics`` returns what Prometheus is told; it is called by the feed's thread, when asked.

        ``feeds``: the live view's Unix socket; where there is none, it is tried again every second.
        """
        self._service = service
        self._log = log
        self._feeds = feeds
        self._metrics = metrics
        self._fifo_priority = min(fifo_priority, 1)
        self._topics: Sequence[Topic] = ()
        self._session = ""
        self._wanted: frozenset[int] = _NOBODY
        self._once: dict[int, _Message] = {}
        self._queue: LatestQueue[_Message] = LatestQueue()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._ending = threading.Event()
        self._link: socket.socket | None = None
        self._thread = threading.Thread(target=self._feed, name="live-feed", daemon=True)

    @property
    def dropped(self) -> int:
        """Messages that made room for newer ones."""
        return self._queue.dropped

    def opened(self, recording: bool, fifo_priority: int = 0) -> OpenSink:
        """What opens a recorder's sink: a recording that is also shown, or, without one, the show alone."""

        def made(path: Path, topics: Sequence[Topic], entries: Entries) -> RecordSink:
            sink: RecordSink = self
            if recording:
                sink = RecordingThread(path, topics, entries, fifo_priority, tap=self.offer)
            self._topics, self._session = topics, entries.get("session", {}).get("id", "")
            sys.setswitchinterval(_SWITCH_S)
            self._thread.start()
            return sink

        return made

    def wants(self, topic: int) -> bool:
        """Whether somebody looks at topic number ``topic``."""
        return topic in self._wanted

    def offer(self, topic: int, data: bytes, log_ns: int) -> None:
        """Show a message as it was recorded, if somebody looks."""
        self._keep(topic, (data, log_ns, True), len(data))

    def put(self, topic: int, message: Any, log_ns: int, publish_ns: int, *, wanted: bool = False) -> None:
        """Show a message that is not recorded, if somebody looks: the thread encodes it."""
        self._keep(topic, (message, log_ns, False), _NOT_ENCODED)

    def close(self) -> None:
        """End the thread and the connection. What waits is not sent any more."""
        if self._ending.is_set():
            return
        self._ending.set()
        os.eventfd_write(self._wake, 1)
        with contextlib.suppress(OSError, AttributeError):
            self._link.shutdown(socket.SHUT_RDWR)  # type: ignore[union-attr]  # wakes a thread that sends
        if self._thread.is_alive():
            self._thread.join(_CLOSE_S)
        if not self._thread.is_alive():
            os.close(self._wake)

    def _keep(self, topic: int, message: _Message, size: int) -> None:
        if self._topics[topic].once:
            self._once[topic] = message
        if topic in self._wanted:
            self._queue.put(topic, message, size)
            os.eventfd_write(self._wake, 1)

    def _feed(self) -> None:
        take_fifo(self._fifo_priority)
        failed = 0
        while not self._ending.is_set():
            try:
                with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as self._link:
                    self._link.connect(self._feeds)
                    self._link.sendall(wire.hello(self._service, self._session, self._topics))
                    self._serve(self._link)
            except OSError as error:
                failed += 1
                if failed == _TELL_AFTER:
                    why = {"cause": "link.live_face_absent", "detail": str(error)}
                    self._log.write("live_face_absent", "warning", **why)
            finally:
                self._wanted = _NOBODY
            self._ending.wait(_RETRY_S)

    def _serve(self, link: socket.socket) -> None:
        """Feed one connection until it ends."""
        unread = b""
        waited: list[Any] = [link, self._wake]
        while not self._ending.is_set():
            readable, _, _ = select.select(waited, [], [])
            if self._wake in readable:
                with contextlib.suppress(BlockingIOError):
                    os.eventfd_read(self._wake)
            if link in readable:
                data = link.recv(1 << 16)
                if not data:
                    return
                *lines, unread = (unread + data).split(b"\n")
                for line in lines:
                    self._answer(link, json.loads(line))
            while (taken := self._queue.take()) is not None:
                self._send(link, *taken)

    def _answer(self, link: socket.socket, document: dict[str, Any]) -> None:
        if "wanted" in document:
            self._wanted = frozenset(document["wanted"])
            for topic in sorted(self._once.keys() & document["again"]):
                self._send(link, topic, self._once[topic])
        else:
            link.sendall(wire.frame(wire.METRICS, self._metrics_text().encode()))

    def _metrics_text(self) -> str:
        for _ in range(3):
            try:
                return self._metrics()
            except Exception as error:  # such as a table that the loop was adding to, or a part not yet made
                why = repr(error)
        self._log.write_repeated("figures", "live_failed", "warning", cause="internal", detail=why)
        return ""

    def _send(self, link: socket.socket, topic: int, message: _Message) -> None:
        what, log_ns, encoded = message
        try:
            data = what if encoded else self._topics[topic].encode(what)
        except Exception as error:  # what cannot be encoded is not shown; the service goes on
            name = self._topics[topic].name
            why = f"{name}: {error!r}"
            self._log.write_repeated(name, "live_failed", "warning", cause="internal", detail=why)
            return
        link.sendall(wire.frame(wire.MESSAGE, data, topic, log_ns))


def open_show(
    service: str,
    log: EventLog,
    metrics: Callable[[], str],
    fifo_priority: int = 0,
    environment: Mapping[str, str] = os.environ,
) -> LiveFeed | None:
    """The feed of a service into the live view that LONGREACH_LIVE names; where it names none, none."""
    feeds = environment.get(FEEDS_VARIABLE)
    return LiveFeed(service, log, feeds, metrics, fifo_priority) if feeds else None
