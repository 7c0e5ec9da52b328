"""The camera stream over loopback: every byte in place, newest first, nobody waits for a slow client."""

import socket
import time
from collections.abc import Iterator

import numpy as np
import pytest

from plant_emulator.shell.frame_server import PLACES, FrameServer, StereoFrame
from protocol.stereo_frame import HEADER_BYTES, FrameHeader, decode_header

pytestmark = pytest.mark.realtime

SHAPE = (720, 1280)


def frame(number: int) -> StereoFrame:
    """A pair whose pixels tell its number."""
    left = np.full(SHAPE, number % 251, dtype=np.uint8)
    return StereoFrame(number, 1000 * number, 4000, left, left + 1)


@pytest.fixture
def server() -> Iterator[tuple[FrameServer, int]]:
    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    frames = FrameServer(listener)
    frames.start()
    yield frames, listener.getsockname()[1]
    frames.stop()


def client(frames: FrameServer, port: int, count: int = 1) -> socket.socket:
    """A connected client that the server has noticed as its ``count``-th."""
    sock = socket.create_connection(("127.0.0.1", port), timeout=5.0)
    wait_until(lambda: frames.statistics()["clients"] == count)
    return sock


def wait_until(condition: object) -> None:
    """Return when ``condition()`` holds; fail after a minute."""
    assert callable(condition)
    limit = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.005)


def receive(sock: socket.socket) -> tuple[FrameHeader, bytes]:
    """One frame."""
    header = decode_header(exactly(sock, HEADER_BYTES))
    return header, exactly(sock, header.payload_bytes)


def exactly(sock: socket.socket, count: int) -> bytes:
    """``count`` bytes."""
    data = b""
    while len(data) < count:
        piece = sock.recv(count - len(data))
        assert piece, "the stream ended"
        data += piece
    return data


def test_a_frame_arrives_whole(server: tuple[FrameServer, int]) -> None:
    frames, port = server
    with client(frames, port) as sock:
        before = time.monotonic_ns()
        frames.publish(frame(7))
        header, payload = receive(sock)
        assert header._replace(send_ns=0) == FrameHeader(7, 7000, 0, 1280, 720, 4000, 0)
        assert before <= header.send_ns <= time.monotonic_ns()
        pixels = SHAPE[0] * SHAPE[1]
        assert payload == bytes([7]) * pixels + bytes([8]) * pixels


def receive_after(frames: FrameServer, sock: socket.socket, number: int) -> tuple[FrameHeader, bytes]:
    """The frame that arrives after publishing ``number``."""
    frames.publish(frame(number))
    return receive(sock)


def test_a_slow_client_misses_frames_and_delays_nobody(server: tuple[FrameServer, int]) -> None:
    frames, port = server
    slow = socket.socket()
    slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
    slow.connect(("127.0.0.1", port))
    slow.settimeout(5.0)
    with slow:
        wait_until(lambda: frames.statistics()["clients"] == 1)
        for number in range(1, 51):
            frames.publish(frame(number))
            time.sleep(0.002)
        first, _ = receive(slow)
        last, _ = receive(slow)
        assert first.frame_id < 40
        assert last.frame_id == 50
        wait_until(lambda: frames.statistics()["frames_sent"] == 2)
        assert frames.statistics()["frames_dropped_slow"] == 48
        assert receive_after(frames, slow, 51)[0].frame_id == 51


def test_a_client_that_left_is_forgotten(server: tuple[FrameServer, int]) -> None:
    frames, port = server
    client(frames, port).close()
    for number in range(1, 20):
        frames.publish(frame(number))
        time.sleep(0.005)
    wait_until(lambda: frames.statistics()["clients"] == 0)
    assert not frames.watched


def test_stopping_hangs_up(server: tuple[FrameServer, int]) -> None:
    frames, port = server
    with client(frames, port) as sock:
        frames.stop()
        assert sock.recv(1) == b""


def test_whoever_takes_frames_keeps_its_place_among_many_that_take_none(
    server: tuple[FrameServer, int],
) -> None:
    frames, port = server
    with client(frames, port) as sock:
        frames.publish(frame(1))
        assert receive(sock)[0].frame_id == 1
        wait_until(lambda: frames.statistics()["frames_sent"] == 1)
        idle = [socket.create_connection(("127.0.0.1", port), timeout=5.0) for _ in range(3 * PLACES)]
        wait_until(lambda: frames.statistics()["clients_displaced"] == 2 * PLACES + 1)
        wait_until(lambda: frames.statistics()["clients"] == PLACES)
        assert idle[0].recv(1) == b""
        assert receive_after(frames, sock, 2)[0].frame_id == 2
        for other in idle:
            other.close()
