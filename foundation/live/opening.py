"""A service's feed, opened as its configuration and environment say."""

import contextlib
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping

from foundation.event_log import EventLog
from foundation.live.feed import LiveFeed, shared_face
from foundation.live.settings import LiveSettings
from foundation.live.wire import SHARED_VARIABLE
from foundation.ports import bound_tcp
from foundation.rest.access import Access, configured_access

_END_S = 1.0


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
        self._process: subprocess.Popen[bytes] | None = None

    def connect(self) -> socket.socket:
        """Start the process. Raises OSError when it had been started before: it has ended by itself then."""
        if self._process is not None:
            raise OSError(f"the live face ended with status {self._process.poll()}")
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        with theirs, self._listener:
            inherited = (self._listener.fileno(), theirs.fileno())
            self._process = subprocess.Popen(
                [sys.executable, "-m", "foundation.live", "own", *map(str, inherited), self._name],
                stdin=subprocess.PIPE,
                pass_fds=inherited,
            )
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError), self._process.stdin as stdin:
            stdin.write(self._settings.model_dump_json().encode())
        return ours

    def close(self) -> None:
        """End the process, whose socket is closed by now; a port that nobody served is left."""
        self._listener.close()
        if self._process is None:
            return
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class LiveShow:
    """What a service has of its live face: its ``feed``, and where viewers find it."""

    def __init__(self, feed: LiveFeed, own: OwnFace | None) -> None:
        self.feed = feed
        self._own = own

    @property
    def address(self) -> dict[str, str | int] | None:
        """Host and port of a face of its own; none where it is shared."""
        return None if self._own is None else dict(zip(("host", "port"), self._own.address, strict=True))

    def close(self) -> None:
        """End it."""
        self.feed.close()
        if self._own is not None:
            self._own.close()


def open_show(
    service: str,
    settings: LiveSettings,
    setting: str,
    log: EventLog,
    figures: Callable[[], str],
    fifo_priority: int = 0,
    environment: Mapping[str, str] = os.environ,
) -> LiveShow | None:
    """The show of a service: at the face that LONGREACH_LIVE names, else at one of its own where
    ``settings``, found at ``setting``, name a port; else none.

    Raises ConfigurationError as ``OwnFace`` does.
    """
    if name := environment.get(SHARED_VARIABLE):
        return LiveShow(LiveFeed(service, log, shared_face(name), figures, fifo_priority), None)
    if settings.port is None:
        return None
    own = OwnFace(service, settings, setting)
    return LiveShow(LiveFeed(service, log, own.connect, figures, fifo_priority), own)
