"""ADS over TCP, served between two scans: what waits is read, a bounded part of it is answered, nobody is
waited for.
"""

import contextlib
import socket
import time
from typing import NamedTuple

from controller_st.ads_device import AdsClient, AdsDevice
from controller_st.ads_frames import MAX_FRAME, StreamBroken, cut
from foundation.event_log import EventLog
from protocol.errors import ConfigurationError

CLIENTS = 8
_PIECE = 16 * 1024  # bytes read of a connection in one turn
_BUDGET_NS = 300_000  # of a scan's period: then the others wait for the next one
_UNSENT = 2 * MAX_FRAME  # bytes that a client may leave unread


class _Connection(NamedTuple):
    socket: socket.socket
    address: str
    client: AdsClient
    came: bytearray
    unsent: bytearray


class AdsPort:
    """Listens for ADS clients, and serves them whenever ``serve`` is called."""

    def __init__(self, device: AdsDevice, host: str, port: int, log: EventLog) -> None:
        """Bind. Raises ConfigurationError (``configuration.ads_port``)."""
        self._device, self._log = device, log
        self._connections: list[_Connection] = []
        try:
            self._listening = socket.create_server((host, port), backlog=CLIENTS)
        except OSError as error:
            why = f"controller.ads: {host}:{port}: {error.strerror}"
            raise ConfigurationError("configuration.ads_port", why) from error
        self._listening.setblocking(False)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port."""
        host, port = self._listening.getsockname()[:2]
        return host, port

    def serve(self, now_ns: int) -> None:
        """Take in, answer and send what is possible within the budget; ``now_ns`` is monotonic."""
        self._accept()
        until_ns = time.monotonic_ns() + _BUDGET_NS
        for connection in list(self._connections):
            try:
                self._serve(connection, now_ns, until_ns)
            except StreamBroken as broken:
                self._end(connection, broken.cause, str(broken))
            except OSError as error:
                self._end(connection, "ads.connection_lost", str(error.strerror))
        self._connections = self._connections[1:] + self._connections[:1]  # another is first next time

    def close(self) -> None:
        """End all connections and stop listening."""
        for connection in self._connections:
            connection.socket.close()
        self._connections.clear()
        self._listening.close()

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            came, address = self._listening.accept()
            if len(self._connections) >= CLIENTS:
                came.close()
                self._log.write_repeated(
                    "ads.full", "ads_refused", "warning", cause="ads.full", limit=CLIENTS
                )
                return
            came.setblocking(False)
            came.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._connections.append(
                _Connection(came, str(address[0]), AdsClient(), bytearray(), bytearray())
            )

    def _serve(self, connection: _Connection, now_ns: int, until_ns: int) -> None:
        came, unsent = connection.came, connection.unsent
        if len(came) < MAX_FRAME and len(unsent) < MAX_FRAME:  # who does not read is not read from
            with contextlib.suppress(BlockingIOError):
                piece = connection.socket.recv(_PIECE)
                if not piece:
                    self._end(connection, "", "")
                    return
                came += piece
        while len(unsent) < MAX_FRAME and time.monotonic_ns() < until_ns and (frame := cut(came)) is not None:
            if frame.is_request:
                unsent += self._device.answer(connection.client, frame, now_ns).packed
        due = self._device.due(connection.client, now_ns, time.time_ns())
        if due is not None:
            unsent += due.packed
        if len(unsent) > _UNSENT:
            raise StreamBroken("ads.not_read", f"{len(unsent)} bytes wait to be read, {_UNSENT} at most")
        if unsent:
            with contextlib.suppress(BlockingIOError):
                del unsent[: connection.socket.send(unsent)]

    def _end(self, connection: _Connection, cause: str, detail: str) -> None:
        connection.socket.close()
        self._connections.remove(connection)
        if cause:
            self._log.write_repeated(
                cause, "ads_ended", "warning", cause=cause, detail=f"{connection.address}: {detail}"
            )
