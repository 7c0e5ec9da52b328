"""The emulated camera: stereo frames over raw TCP, received into buffers that are used again."""

import socket
import time
from collections import deque

import numpy as np

from foundation import clock
from protocol.errors import FrameRefused, LinkLost
from protocol.stereo_frame import HEADER_BYTES, FrameHeader, decode_header
from vision_pc.config.camera import CameraSettings
from vision_pc.core.buffers import BufferPool
from vision_pc.core.types import StereoPair
from vision_pc.shell.cameras.source import CameraSource

_RECEIVE_BUFFER_BYTES = 1 << 20
_CLOCK_WINDOW = 200  # frames whose least delay gives the sender's clock
_WITHIN_S = 1.0  # of the wall
_POLL_S = 0.2  # how soon the thread sees that it is to stop


class StreamClock:
    """Maps the sender's clock to this machine's: the least of receive − send over the last frames.

    The least delayed frame is late by the shortest way through the sockets (well under a millisecond on one
    machine); every other frame's delay is then seen and taken off.
    """

    def __init__(self) -> None:
        self._differences: deque[int] = deque(maxlen=_CLOCK_WINDOW)

    def local_ns(self, sender_ns: int, send_ns: int, receive_ns: int) -> int:
        """``sender_ns`` on this machine's clock, with one more pair of ``send_ns`` and ``receive_ns``
        learnt.
        """
        self._differences.append(receive_ns - send_ns)
        return sender_ns + min(self._differences)


class StreamCamera(CameraSource):
    """Connects to the stream, and again whenever it ends, is silent for too long or loses its place.

    By the plant's clock a picture arrives at the time that the plant tells, and that time stands until then.
    """

    def __init__(self, settings: CameraSettings) -> None:
        super().__init__(settings)
        self._pool = BufferPool()
        self._plant = clock.followed()
        self._come: deque[tuple[StereoPair | None, int]] = deque()
        self._flows, self._taken, self._complete_s = False, 0, time.monotonic()
        if self._plant is not None:
            self._plant.on_time.append(self._take)
            self._plant.ready_to_answer.append(self._is_complete)

    def _produce(self) -> None:
        stream = self._settings.stream
        while not self._stop.is_set():
            try:
                with socket.create_connection((stream.host, stream.port), timeout=_POLL_S) as connection:
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
                    self._is_there()
                    self._receive(connection)
            except (FrameRefused, LinkLost) as error:
                self._is_gone(error.cause, str(error))
            except OSError:
                self._is_gone("link.camera_missing")
            self._stop.wait(stream.reconnect_ms / 1e3)

    def _receive(self, connection: socket.socket) -> None:
        """Deliver frames until the connection ends; OSError, LinkLost or FrameRefused say why."""
        sender, header_bytes, last_id = StreamClock(), np.empty(HEADER_BYTES, dtype=np.uint8), None
        while not self._stop.is_set():
            self._fill(connection, header_bytes.data)
            receive_ns = clock.now_ns()
            header = decode_header(header_bytes.tobytes())
            self._check(header)
            pixels = self._pool.take(header.payload_bytes)
            self._fill(connection, pixels.data)
            left, right = pixels.reshape(2, header.height, header.width)
            if self._plant is None:
                capture_ns = sender.local_ns(header.capture_ns, header.send_ns, receive_ns)
            else:
                capture_ns = header.capture_ns + self._plant.offset_ns
            dropped = 0 if last_id is None else max(header.frame_id - last_id - 1, 0)
            if last_id is None or header.frame_id > last_id:
                self._deliver(StereoPair(left, right, capture_ns, header.frame_id), dropped)
            else:
                self._call(self._arrived, None, 0)
            last_id = header.frame_id
            del left, right, pixels  # or the pool would think them read

    def connected(self) -> None:
        """Note that the stream stands: what is published from now on comes."""
        super().connected()
        if self._plant is not None:
            self._come.clear()
            self._flows, self._taken = True, self._plant.pictures

    def lost(self, cause: str, detail: str = "") -> None:
        """Note that it does not stand."""
        super().lost(cause, detail)
        self._flows = False

    def _arrived(self, pair: StereoPair | None, dropped: int) -> None:
        if self._plant is not None:
            self._come.append((pair, dropped))
            self._take()
        elif pair is not None:
            super()._arrived(pair, dropped)

    def _take(self) -> None:
        """Take what has come and whose time it is."""
        assert self._plant is not None
        while self._come and self._taken < self._plant.pictures:
            self._taken += 1
            pair, dropped = self._come.popleft()
            if pair is not None:
                super()._arrived(pair, dropped)

    def _is_complete(self) -> bool:
        """Whether every picture has come whose time it is; what has not come within a second will not."""
        assert self._plant is not None
        now_s = time.monotonic()
        if not self._flows or self._taken >= self._plant.pictures:
            self._complete_s = now_s
        elif now_s - self._complete_s > _WITHIN_S:
            self._taken, self._complete_s = self._plant.pictures, now_s
        return self._complete_s == now_s

    def _fill(self, connection: socket.socket, target: memoryview) -> None:
        """Receive until ``target`` is full; raises LinkLost when the stream ends or is silent too long."""
        received, last_ns = 0, clock.now_ns()
        while received < len(target):
            try:
                count = connection.recv_into(target[received:])
            except TimeoutError:
                if self._stop.is_set() or clock.now_ns() - last_ns > self._settings.stale_ms * 1e6:
                    raise LinkLost("link.camera_silent", "the stream stands but nothing comes") from None
                continue
            if count == 0:
                raise LinkLost("link.camera_missing", "the camera closed the stream")
            received, last_ns = received + count, clock.now_ns()

    def _check(self, header: FrameHeader) -> None:
        wanted = (self._settings.width_px, self._settings.height_px)
        if (header.width, header.height) != wanted:
            raise FrameRefused(
                "frame.wrong_size",
                f"pictures are {header.width}×{header.height} px, configured are {wanted[0]}×{wanted[1]}",
            )
