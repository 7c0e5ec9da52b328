"""The UDP end of the reference link: datagrams are read as they arrive, requests wait for the next scan.

Heartbeats are answered at once, so that the peer's clock estimate is not blurred by the scan's period. Of a
flood of the peer's a slice is judged in a cycle; all of it is read before the scan, lest a stop be in it.
While a session is open its peer has a socket of its own, connected on the same port: the kernel sorts, and
what strangers send can neither fill the peer's buffer nor cost the scan more than a few datagrams a cycle.
"""

import asyncio
import contextlib
import socket
import struct
from collections import Counter

from controller.config import ReferenceLinkConfig
from controller.core.arrivals import A_CYCLE, Arrivals
from controller.core.inbox import Inbox
from foundation import clock
from foundation.event_log import EventLog
from foundation.secret_source import bound_udp
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

_ANYBODYS_A_CYCLE = 96  # while there is no peer
_READ_A_CYCLE = 4096  # of the peer's; the kernel's buffer holds fewer
_STRANGERS_A_CYCLE = 8  # while there is one: enough to refuse a second client
_ALL = "0.0.0.0"
_IP_PKTINFO = 8  # of Linux; Python has no name for it before 3.14
_PACKET_INFO = struct.Struct("=I4s4s")  # interface, our address, the datagram's destination
_ANCILLARY_BYTES = socket.CMSG_SPACE(_PACKET_INFO.size)
_ADDRESSES = 64
_RECEIVE_BUFFER_BYTES = 1 << 20  # the kernel grants what it is allowed to


class _Reader:
    """One socket, what was read from it, and how much of that may still be judged in this cycle.

    ``local``: by source, which of this host's addresses was asked, where the socket listens on all of them.
    """

    def __init__(self, sock: socket.socket) -> None:
        self.socket = sock
        self._everywhere = sock.getsockname()[0] == _ALL
        if self._everywhere:
            sock.setsockopt(socket.IPPROTO_IP, _IP_PKTINFO, 1)
        self.local: dict[object, bytes] = {}
        self.arrivals = Arrivals()
        self.left = 0
        self.paused = False

    def read(self, most: int, session: int | None) -> int:
        """How many datagrams were left out, once what has come is read, at most so many."""
        left_out = 0
        for _ in range(most):
            try:
                if self._everywhere:
                    data, ancillary, _, source = self.socket.recvmsg(MAX_DATAGRAM_BYTES + 1, _ANCILLARY_BYTES)
                    self._note(source, ancillary)
                else:
                    data, source = self.socket.recvfrom(MAX_DATAGRAM_BYTES + 1)
            except BlockingIOError:
                break
            except OSError:  # an earlier answer met a closed port
                continue
            left_out += self.arrivals.put(data, source, session)
        return left_out

    def _note(self, source: object, ancillary: list[tuple[int, int, bytes]]) -> None:
        """Remember which of our addresses ``source`` asked; of strangers the newest few."""
        self.local.pop(source, None)
        self.local[source] = _PACKET_INFO.unpack(ancillary[0][2])[1]
        if len(self.local) > _ADDRESSES:
            del self.local[next(iter(self.local))]


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
        self._peers: _Reader | None = None
        self._peer: object = None  # whom it is connected to; kept after the session, for who greets at once
        self._peer_local: dict[object, bytes] = {}  # kept while strangers fill the other one
        self._socket = bound_udp(config.host, config.port, "controller.reference_link")
        _enlarge(self._socket)
        self._everybodys = _Reader(self._socket)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port, as bound."""
        host, port = self._socket.getsockname()
        return host, port

    def open(self) -> None:
        """Begin to read; needs a running loop."""
        self._watch(self._everybodys)

    def release(self) -> None:
        """Close a port that was never opened."""
        self._socket.close()

    def close(self) -> None:
        """Say goodbye to the peer and release the port."""
        now_ns = clock.now_ns()
        self._report_events(self.server.close(now_ns, Reason.SHUTDOWN))
        self._send()
        self._rejoin()
        self._unwatch(self._everybodys)

    def take(self, now_ns: int) -> tuple[tuple[Request, ...], bool]:
        """Requests for the scan at ``now_ns`` and whether the link is alive, see Inbox.

        All that has come is read first, so that no stop among it misses this scan.
        """
        self._report_events(self.server.tick(now_ns))
        for reader in self._readers():
            self.flooded += reader.paused
            reader.left = self._budget(reader)
            self._serve(reader)
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

    def _readers(self) -> list[_Reader]:
        return [self._everybodys] if self._peers is None else [self._peers, self._everybodys]

    def _budget(self, reader: _Reader) -> int:
        if reader is self._everybodys and self._peers is not None and self.server.session is not None:
            return _STRANGERS_A_CYCLE
        return A_CYCLE if self.server.session is not None else _ANYBODYS_A_CYCLE

    def _watch(self, reader: _Reader) -> None:
        reader.left = self._budget(reader)
        self._resume(reader)

    def _resume(self, reader: _Reader) -> None:
        reader.paused = False
        asyncio.get_running_loop().add_reader(reader.socket.fileno(), self._serve, reader)

    def _pause(self, reader: _Reader) -> None:
        reader.paused = True
        asyncio.get_running_loop().remove_reader(reader.socket.fileno())

    def _unwatch(self, reader: _Reader) -> None:
        if not reader.paused:
            asyncio.get_running_loop().remove_reader(reader.socket.fileno())
        reader.socket.close()

    def _serve(self, reader: _Reader) -> None:
        """Read, and judge what may still be judged in this cycle; the rest waits for the next one."""
        mine = reader is self._peers or (self._peers is None and self.server.session is not None)
        most = _READ_A_CYCLE if mine else reader.left - len(reader.arrivals)
        left_out = reader.read(most, self.server.session)
        if left_out:
            self._count_drop("link.left_out", "more came than can be judged in time", left_out)
        slice_ = reader.arrivals.take(reader.left)
        reader.left -= len(slice_)
        if reader.left > 0 and reader.paused:
            self._resume(reader)
        elif reader.left <= 0 and not reader.paused:
            self._pause(reader)
        self._report_events(self.server.receive_batch(slice_, clock.now_ns()))
        self._send()

    def _send(self) -> None:
        for data, source in self.server.outgoing(clock.now_ns()):
            clock.current().sent = True
            with contextlib.suppress(OSError):  # the peer's absence is found by its silence
                at = self._everybodys.local.get(source) or self._peer_local.get(source)
                if at is None:
                    self._socket.sendto(data, source)  # type: ignore[call-overload]
                else:  # an answer leaves from the address that was asked
                    info = (socket.IPPROTO_IP, _IP_PKTINFO, _PACKET_INFO.pack(0, at, bytes(4)))
                    self._socket.sendmsg([data], [info], 0, source)  # type: ignore[arg-type]

    def _report_events(self, events: list[ServerEvent]) -> None:
        for answer in self._inbox.put(events):
            self.server.acknowledge(answer, clock.now_ns())
        for event in events:
            if isinstance(event, SessionOpened):
                self._part(event.source)
                self._log.write("session_opened", session=f"{event.session:x}", peer=str(event.source))
            elif isinstance(event, SessionClosed):
                self._log.write("session_closed", session=f"{event.session:x}", reason=event.reason.name)
            elif isinstance(event, DatagramDropped):
                self._count_drop(event.cause, event.detail, 1)

    def _count_drop(self, cause: str, detail: str, count: int) -> None:
        self.drops[cause] += count
        fields = {"cause": cause, "detail": detail, "count": self.drops[cause]}
        self._log.write_repeated(cause, "datagram_dropped", "warning", **fields)

    def _part(self, peer: object) -> None:
        """A socket of the peer's own, from now on; without one all share the first, as before."""
        at = self._everybodys.local.get(peer)
        if self._peers is not None and peer == self._peer and at in (None, self._peer_local.get(peer)):
            return
        self._rejoin()
        self._peer_local = {} if at is None else {peer: at}
        own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        own.setblocking(False)
        _enlarge(own)
        try:
            # Two sockets may have one port only while both agree; a second controller shall not get it.
            for each in (self._socket, own):
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            own.bind(self.address if at is None else (socket.inet_ntoa(at), self.address[1]))
            own.connect(peer)  # type: ignore[arg-type]
        except OSError as error:
            own.close()
            self._log.write("peer_not_parted", "warning", cause="link.shared_socket", detail=str(error))
        else:
            self._peers, self._peer = _Reader(own), peer
            self._watch(self._peers)
        finally:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)

    def _rejoin(self) -> None:
        self._peer_local = {}
        if self._peers is not None:
            own, self._peers = self._peers, None
            self._unwatch(own)


def _enlarge(sock: socket.socket) -> None:
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
