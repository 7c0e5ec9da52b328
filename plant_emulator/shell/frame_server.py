"""Streams the newest stereo frame to every client over raw TCP; slow clients miss frames, delay nobody."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core.layout import who_yields
from protocol.stereo_frame import FrameHeader, encode_header

_SEND_BUFFER_BYTES = 1 << 19  # about a quarter of a 720p pair: what waits in the kernel must not grow old
_STALLED_S = 5.0
PLACES = 16


class StereoFrame(NamedTuple):
    """One rendered pair, (height, width) uint8 each, and its place in time.

    ``sent_ns``: when it was sent, None: at the moment, by this machine's monotonic clock.
    """

    frame_id: int
    capture_ns: int
    exposure_us: int
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    sent_ns: int | None = None


class _Client:
    """A connection: from where, how many frames it has taken, and when the last."""

    def __init__(self, sock: socket.socket, address: str) -> None:
        self.sock = sock
        self.address = address
        self.served = 0
        self.heard_ns = time.monotonic_ns()


class FrameServer:
    """Serves ``listener`` with one thread a client. ``publish`` never waits for a client.

    ``on_client`` is called, in a thread, when one more is served. There are PLACES; a newcomer takes that of
    a client that never took a frame, or took none for longest.
    """

    def __init__(self, listener: socket.socket, on_client: Callable[[], None] = lambda: None) -> None:
        self._listener, self._on_client = listener, on_client
        self._newest: StereoFrame | None = None
        self._published = 0
        self._closing = False
        self._changed = threading.Condition()
        self._clients: set[_Client] = set()
        self._displaced = 0
        self._sent = 0
        self._dropped = 0
        self._threads: list[threading.Thread] = []

    def start(self) -> None:
        """Begin to accept clients."""
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        self._listener.listen()
        self._spawn(self._accept)

    def publish(self, frame: StereoFrame) -> None:
        """Make ``frame`` the newest."""
        with self._changed:
            self._newest = frame
            self._published += 1
            self._changed.notify_all()

    @property
    def watched(self) -> bool:
        """Whether anybody is connected."""
        return bool(self._clients)

    def statistics(self) -> dict[str, int]:
        """Clients now, frames sent, and frames that a client was too slow for (summed over clients)."""
        with self._changed:
            return {
                "clients": len(self._clients),
                "frames_sent": self._sent,
                "frames_dropped_slow": self._dropped,
                "clients_displaced": self._displaced,
            }

    def stop(self) -> None:
        """Disconnect everybody and stop listening."""
        with self._changed:
            self._closing = True
            clients = [client.sock for client in self._clients]
            self._changed.notify_all()
        for sock in (self._listener, *clients):
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for thread in self._threads:
            thread.join(1.0)

    def _accept(self) -> None:
        while True:
            try:
                sock, (address, _) = self._listener.accept()
            except OSError:
                return
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.settimeout(_STALLED_S)
            client = _Client(sock, address)
            with self._changed:
                if self._closing:
                    sock.close()
                    return
                yielding = who_yields(self._clients, address, None, PLACES, PLACES)
                if yielding is not None:
                    self._clients.discard(yielding)
                    self._displaced += 1
                    with contextlib.suppress(OSError):
                        yielding.sock.shutdown(socket.SHUT_RDWR)
                    self._changed.notify_all()
                self._clients.add(client)
                seen = self._published
            self._spawn(self._serve, client, seen)
            self._on_client()

    def _serve(self, client: _Client, seen: int) -> None:
        with contextlib.suppress(OSError), client.sock:
            while True:
                with self._changed:
                    self._changed.wait_for(
                        lambda seen=seen: self._over(client) or self._published > seen  # type: ignore[misc]
                    )
                    if self._over(client) or self._newest is None:
                        break
                    frame = self._newest
                    self._dropped += self._published - seen - 1
                    seen = self._published
                _send(client.sock, frame)
                with self._changed:
                    self._sent += 1
                    client.served += 1
                    client.heard_ns = time.monotonic_ns()
        with self._changed:
            self._clients.discard(client)

    def _over(self, client: _Client) -> bool:
        return self._closing or client not in self._clients

    def _spawn(self, target: object, *arguments: object) -> None:
        thread = threading.Thread(target=target, args=arguments, daemon=True)  # type: ignore[arg-type]
        self._threads = [old for old in self._threads if old.is_alive()]
        self._threads.append(thread)
        thread.start()


def _send(client: socket.socket, frame: StereoFrame) -> None:
    height, width = frame.left.shape
    header = FrameHeader(
        frame_id=frame.frame_id,
        capture_ns=frame.capture_ns,
        send_ns=time.monotonic_ns() if frame.sent_ns is None else frame.sent_ns,
        width=width,
        height=height,
        exposure_us=frame.exposure_us,
        flags=0,
    )
    client.sendall(encode_header(header))
    client.sendall(frame.left.data)
    client.sendall(frame.right.data)
