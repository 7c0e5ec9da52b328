"""The UDP end of the reference link: datagrams are read as they arrive, requests wait for the next scan.

Heartbeats are answered at once, so that the peer's clock estimate is not blurred by the scan's period.
A flood is met by a budget of datagrams a cycle; what exceeds it stays in the kernel's buffer, which drops
the rest.
"""

import asyncio
import contextlib
import errno
import socket
import time
from collections import Counter

from controller.config import ReferenceLinkConfig
from controller.core.inbox import Inbox
from controller.shell.event_log import EventLog
from protocol.errors import ConfigurationError
from protocol.faults import Reason
from protocol.reference_link import (
    MAX_DATAGRAM_BYTES,
    Acknowledgement,
    Request,
    State,
    StreamRefused,
)
from protocol.reference_session import (
    DatagramDropped,
    ReferenceServer,
    ServerEvent,
    SessionClosed,
    SessionOpened,
    StreamedPoseReceived,
)

_READS_A_CYCLE = 600  # about a millisecond; 50 000 datagrams a second are 250 in a cycle of 5 ms
_DATAGRAMS_A_CYCLE = 96  # of those, decoded
# Room for what a flood leaves between two cycles; the kernel grants what it is allowed to.
_RECEIVE_BUFFER_BYTES = 1 << 20
_STRANGERS_A_CYCLE = 8  # of those, while a session is open: enough to refuse a second client


class ReferencePort:
    """A bound socket around the sans-IO ``server``.

    ``drops``: datagrams that were not used, by cause; ``flooded``: those of strangers that were not even
    looked at.
    """

    def __init__(self, server: ReferenceServer, config: ReferenceLinkConfig, log: EventLog) -> None:
        """Bind. Raises ConfigurationError when the address is busy or not ours."""
        self.server = server
        self.flooded = 0
        self.drops: Counter[str] = Counter()
        self._log = log
        self._inbox = Inbox()
        self._peer: object | None = None
        self._reads = _READS_A_CYCLE
        self._datagrams = _DATAGRAMS_A_CYCLE
        self._strangers = _STRANGERS_A_CYCLE
        self._reading = False
        self._socket = _bound(config)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port, as bound."""
        host, port = self._socket.getsockname()
        return host, port

    def open(self) -> None:
        """Begin to read; needs a running loop."""
        asyncio.get_running_loop().add_reader(self._socket.fileno(), self._readable)
        self._reading = True

    def close(self) -> None:
        """Say goodbye to the peer and release the socket."""
        now_ns = time.monotonic_ns()
        self._told(self.server.close(now_ns, Reason.SHUTDOWN))
        self._send()
        self._pause()
        self._socket.close()

    def take(self, now_ns: int) -> tuple[tuple[Request, ...], bool]:
        """Requests for the scan at ``now_ns`` and whether the link is alive, see Inbox.

        Also opens the next cycle's budget.
        """
        self._told(self.server.tick(now_ns))
        self._reads = _READS_A_CYCLE
        self._datagrams = _DATAGRAMS_A_CYCLE
        self._strangers = _STRANGERS_A_CYCLE
        if not self._reading:
            self.open()
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

    def _readable(self) -> None:
        arrived: list[tuple[bytes, object]] = []
        while self._reads > 0 and self._datagrams > 0:
            self._reads -= 1
            try:
                data, source = self._socket.recvfrom(MAX_DATAGRAM_BYTES + 1)
            except BlockingIOError:
                break
            except OSError:  # an earlier answer met a closed port
                continue
            if self._peer is not None and source != self._peer:
                self._strangers -= 1
                if self._strangers < 0:
                    self.flooded += 1
                    continue
            self._datagrams -= 1
            arrived.append((data, source))
        self._told(self.server.receive_batch(arrived, time.monotonic_ns()))
        self._send()
        # Under a flood reading waits for the next cycle: a batch costs far less than a wake-up for each.
        if self._reads <= 0 or self._datagrams <= 0 or self._strangers < 0:
            self._pause()

    def _pause(self) -> None:
        if self._reading:
            asyncio.get_running_loop().remove_reader(self._socket.fileno())
            self._reading = False

    def _send(self) -> None:
        for data, source in self.server.outgoing(time.monotonic_ns()):
            with contextlib.suppress(OSError):  # the peer's absence is found by its silence
                self._socket.sendto(data, source)  # type: ignore[call-overload]

    def _told(self, events: list[ServerEvent]) -> None:
        self._inbox.put(events)
        for event in events:
            if isinstance(event, SessionOpened):
                self._peer = event.source
                self._log.write("session_opened", session=f"{event.session:x}", peer=str(event.source))
            elif isinstance(event, SessionClosed):
                self._peer = None
                self._log.write("session_closed", session=f"{event.session:x}", reason=event.reason.name)
            elif isinstance(event, DatagramDropped):
                self.drops[event.cause] += 1
                if self.drops[event.cause].bit_count() == 1:  # 1, 2, 4, … : a flood fills no disk
                    fields = {"cause": event.cause, "detail": event.detail, "count": self.drops[event.cause]}
                    self._log.write("datagram_dropped", "warning", **fields)


def _bound(config: ReferenceLinkConfig) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    with contextlib.suppress(OSError):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
    try:
        sock.bind((config.host, config.port))
    except OSError as error:
        sock.close()
        cause = "configuration.port_busy" if error.errno == errno.EADDRINUSE else "configuration.bad_address"
        where = f"controller.reference_link = {config.host}:{config.port}"
        raise ConfigurationError(cause, f"{where}: {error.strerror}") from error
    return sock
