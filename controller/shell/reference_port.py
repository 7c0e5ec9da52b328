"""The UDP end of the reference link: datagrams are read as they arrive, requests wait for the next scan.

Heartbeats are answered at once, so that the peer's clock estimate is not blurred by the scan's period.
While a session is open its peer has a socket of its own, connected on the same port: the kernel sorts, and
what strangers send can neither fill the peer's buffer nor cost the scan more than a few datagrams a cycle.
"""

import asyncio
import contextlib
import socket
import time
from collections import Counter

from controller.config import ReferenceLinkConfig
from controller.core.inbox import Inbox
from foundation.event_log import EventLog
from foundation.ports import bound_udp
from protocol.datagram_layout import MAX_DATAGRAM_BYTES
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, Request, State, StreamRefused
from protocol.server_session import ReferenceServer
from protocol.session_events import (
    DatagramDropped,
    ServerEvent,
    SessionClosed,
    SessionOpened,
    StreamedPoseReceived,
)

_DATAGRAMS_A_CYCLE = 96  # from the peer, or from anybody while there is none
_STRANGERS_A_CYCLE = 8  # while there is one: enough to refuse a second client
_RECEIVE_BUFFER_BYTES = 1 << 20  # the kernel grants what it is allowed to


class ReferencePort:
    """A bound socket around the sans-IO ``server``.

    ``drops``: datagrams that were not used, by cause; ``flooded``: cycles in which more came than was read.
    """

    def __init__(self, server: ReferenceServer, config: ReferenceLinkConfig, log: EventLog) -> None:
        """Bind. Raises ConfigurationError when the address is busy or not ours."""
        self.server = server
        self.flooded = 0
        self.drops: Counter[str] = Counter()
        self._log = log
        self._inbox = Inbox()
        self._left: dict[socket.socket, int] = {}  # datagrams that may still be read in this cycle
        self._paused: set[socket.socket] = set()
        self._peers: socket.socket | None = None
        self._socket = bound_udp(config.host, config.port, "controller.reference_link")
        _enlarge(self._socket)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port, as bound."""
        host, port = self._socket.getsockname()
        return host, port

    def open(self) -> None:
        """Begin to read; needs a running loop."""
        self._watch(self._socket)

    def release(self) -> None:
        """Close a port that was never opened."""
        self._socket.close()

    def close(self) -> None:
        """Say goodbye to the peer and release the port."""
        now_ns = time.monotonic_ns()
        self._told(self.server.close(now_ns, Reason.SHUTDOWN))
        self._send()
        self._rejoin()
        self._unwatch(self._socket)

    def take(self, now_ns: int) -> tuple[tuple[Request, ...], bool]:
        """Requests for the scan at ``now_ns`` and whether the link is alive, see Inbox.

        Also opens the next cycle's budget.
        """
        self._told(self.server.tick(now_ns))
        self.flooded += bool(self._paused)
        for sock in self._left:
            self._left[sock] = self._budget(sock)
        for sock in tuple(self._paused):
            self._paused.discard(sock)
            asyncio.get_running_loop().add_reader(sock.fileno(), self._readable, sock)
        return self._inbox.take(self.server.link_alive(now_ns))

    def take_streamed(self) -> StreamedPoseReceived | None:
        """The newest streamed reference since the last call."""
        return self._inbox.take_streamed()

    def publish(
        self,
        acknowledgements: tuple[Acknowledgement, ...],
        state: State,
        now_ns: int,
        refusal: StreamRefused | None = None,
    ) -> None:
        """Answer what the scan has judged, and send ``state`` when the peer's period has passed."""
        for acknowledgement in acknowledgements:
            self.server.acknowledge(acknowledgement, now_ns)
        if refusal is not None:
            self.server.refuse_streamed(refusal, now_ns)
        self.server.publish(state, now_ns)
        self._send()

    def _budget(self, sock: socket.socket) -> int:
        strangers = self._peers is not None and sock is self._socket
        return _STRANGERS_A_CYCLE if strangers else _DATAGRAMS_A_CYCLE

    def _watch(self, sock: socket.socket) -> None:
        self._left[sock] = self._budget(sock)
        asyncio.get_running_loop().add_reader(sock.fileno(), self._readable, sock)

    def _unwatch(self, sock: socket.socket) -> None:
        self._left.pop(sock, None)
        if sock not in self._paused:
            asyncio.get_running_loop().remove_reader(sock.fileno())
        self._paused.discard(sock)
        sock.close()

    def _readable(self, sock: socket.socket) -> None:
        arrived: list[tuple[bytes, object]] = []
        while self._left[sock] > 0:
            self._left[sock] -= 1
            try:
                arrived.append(sock.recvfrom(MAX_DATAGRAM_BYTES + 1))
            except BlockingIOError:
                break
            except OSError:  # an earlier answer met a closed port
                continue
        if self._left[sock] <= 0:  # the rest waits for the next cycle, or is dropped by the kernel
            asyncio.get_running_loop().remove_reader(sock.fileno())
            self._paused.add(sock)
        self._told(self.server.receive_batch(arrived, time.monotonic_ns()))
        self._send()

    def _send(self) -> None:
        for data, source in self.server.outgoing(time.monotonic_ns()):
            with contextlib.suppress(OSError):  # the peer's absence is found by its silence
                self._socket.sendto(data, source)  # type: ignore[call-overload]

    def _told(self, events: list[ServerEvent]) -> None:
        self._inbox.put(events)
        for event in events:
            if isinstance(event, SessionOpened):
                self._part(event.source)
                self._log.write("session_opened", session=f"{event.session:x}", peer=str(event.source))
            elif isinstance(event, SessionClosed):
                self._rejoin()
                self._log.write("session_closed", session=f"{event.session:x}", reason=event.reason.name)
            elif isinstance(event, DatagramDropped):
                self.drops[event.cause] += 1
                if self.drops[event.cause].bit_count() == 1:  # 1, 2, 4, … : a flood fills no disk
                    fields = {"cause": event.cause, "detail": event.detail, "count": self.drops[event.cause]}
                    self._log.write("datagram_dropped", "warning", **fields)

    def _part(self, peer: object) -> None:
        """A socket of the peer's own, from now on; without one all share the first, as before."""
        self._rejoin()
        own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        own.setblocking(False)
        _enlarge(own)
        try:
            # Two sockets may have one port only while both agree; a second controller shall not get it.
            for each in (self._socket, own):
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            own.bind(self._socket.getsockname())
            own.connect(peer)  # type: ignore[arg-type]
        except OSError as error:
            own.close()
            self._log.write("peer_not_parted", "warning", cause="link.shared_socket", detail=str(error))
        else:
            self._peers = own
            self._watch(own)
        finally:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)

    def _rejoin(self) -> None:
        if self._peers is not None:
            own, self._peers = self._peers, None
            self._unwatch(own)


def _enlarge(sock: socket.socket) -> None:
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
