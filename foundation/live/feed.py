"""A service's feed of its live face, opened as its configuration and environment say."""

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from foundation.child_process import ended
from foundation.event_log import EventLog
from foundation.live import LiveSettings, wire
from foundation.live.wire import SHARED_VARIABLE, LatestQueue
from foundation.periods import take_fifo
from foundation.recording.mcap_file import Entries, Topic
from foundation.recording.messages import RecordingThread, RecordSink
from foundation.recording.recorder import OpenSink
from foundation.rest.guard import Access
from foundation.rest.tokens import configured_access
from foundation.secret_source import bound_tcp

_NOBODY: frozenset[int] = frozenset()
_RETRY_S = 1.0
_TELL_AFTER = 10  # connections that failed
_CLOSE_S = 2.0
_NOT_ENCODED = 1 << 18  # [D] counts as so many bytes: it may hold on to a picture
_SWITCH_S = 0.0001  # as of the recording's thread
_Message = tuple[Any, int, bool]  # what, when, whether it is encoded already


class LiveFeed:
    """Feeds the face that ``connect`` reaches. ``offer`` takes a microsecond and waits for nothing.

    Of topics that nobody wants nothing is kept, but the newest of those that are sent once. ``dropped``:
    messages that made room for newer ones. It is a recorder's sink too, which keeps no file.
    """

    path = Path()
    failure = ""
    written = 0

    def __init__(
        self,
        service: str,
        log: EventLog,
        connect: Callable[[], socket.socket],
        metrics: Callable[[], str],
        fifo_priority: int = 0,
        own: "OwnFace | None" = None,
    ) -> None:
        """``metrics`` returns what Prometheus is told; it is called by the feed's thread, when asked.
        ``own``: the face, where it is of this service alone: it ends with the feed.

        ``connect`` raises OSError where there is no face; it is tried again every second.
        """
        self._service = service
        self._log = log
        self._connect = connect
        self._metrics = metrics
        self._fifo_priority = min(fifo_priority, 1)
        self._own = own
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
    def address(self) -> dict[str, str | int] | None:
        """Host and port of a face of its own; none where it is shared."""
        return None if self._own is None else dict(zip(("host", "port"), self._own.address, strict=True))

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
        """End the thread, the connection, and a face of its own. What waits is not sent any more."""
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
        if self._own is not None:
            self._own.close()

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
                with self._connect() as self._link:
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


def shared_server(name: str) -> socket.socket:
    """A connection to the face that listens at the abstract socket ``name``. Raises OSError."""
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        link.connect("\0" + name)
    except OSError:
        link.close()
        raise
    return link


def access_of(settings: LiveSettings, setting: str) -> Access:
    """Whom the face serves. Raises ConfigurationError as ``read_tokens`` does."""
    origins = frozenset(origin.lower() for origin in settings.allowed_origins)
    return configured_access(settings, setting)._replace(allowed_origins=origins)


class OwnFace:
    """A face that this process starts: ``connect`` gives the other end of its socket, once.

    ``address``: where it serves.
    """

    def __init__(self, service: str, settings: LiveSettings, setting: str) -> None:
        """Raises ConfigurationError for a port that is busy, or tokens that cannot be read."""
        access_of(settings, setting)  # judged here, where a refusal ends the start
        self._name = f"longreach {service}"
        self._settings = settings
        self._listener = bound_tcp(settings.host, settings.port or 0, f"{setting}.port")
        self._listener.listen()
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._process: Any = None

    def connect(self) -> socket.socket:
        """Start the process. Raises OSError when it had been started before: it has ended by itself then."""
        if self._process is not None:
            raise OSError(f"the live face ended with status {self._process.poll()}")
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        with theirs, self._listener:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "foundation.live", self._name, self._settings.model_dump_json()]
                + [str(each.fileno()) for each in (self._listener, theirs)],
                stdin=subprocess.DEVNULL,
                pass_fds=(self._listener.fileno(), theirs.fileno()),
            )
        return ours

    def close(self) -> None:
        """End the process, whose socket is closed by now; a port that nobody served is left."""
        self._listener.close()
        if self._process is not None:
            ended(self._process)


def open_show(
    service: str,
    settings: LiveSettings,
    setting: str,
    log: EventLog,
    metrics: Callable[[], str],
    fifo_priority: int = 0,
    environment: Mapping[str, str] = os.environ,
) -> LiveFeed | None:
    """The feed of a service: of the face that LONGREACH_LIVE names, else of one of its own where
    ``settings``, found at ``setting``, name a port; else none.

    Raises ConfigurationError as ``OwnFace`` does.
    """
    if name := environment.get(SHARED_VARIABLE):
        return LiveFeed(service, log, partial(shared_server, name), metrics, fifo_priority)
    if settings.port is None:
        return None
    own = OwnFace(service, settings, setting)
    return LiveFeed(service, log, own.connect, metrics, fifo_priority, own)
