"""Hostile HTTP, drawn: ``python -m tests.support.hostile_http PORT KIND SEED SECONDS`` sends it to loopback.

Each kind is a way to keep a server busy; ``drawn`` puts requests together by chance from parts that are each
legal, doubtful or wrong. Half of what is drawn comes without the right to ask (a foreign host).
"""

import contextlib
import json
import random
import selectors
import socket
import sys
import time
from collections.abc import Callable, Iterator

Pieces = Iterator[bytes]
_AT_ONCE = 1 << 16


def head(draw: random.Random, method: str, path: str, *fields: str) -> bytes:
    """A head; every other one is of a stranger."""
    host = draw.choice(("127.0.0.1", "evil.example"))
    return "\r\n".join((f"{method} {path} HTTP/1.1", f"Host: {host}", *fields, "", "")).encode()


def tiny_chunks(draw: random.Random) -> Pieces:
    """256 KiB of chunks of one byte."""
    yield head(draw, "POST", "/operations/look", "Transfer-Encoding: chunked")
    yield b"1\r\n \r\n" * 43_690


def chunk_extensions(draw: random.Random) -> Pieces:
    """Chunks with long extensions."""
    yield head(draw, "POST", "/enable", "Transfer-Encoding: chunked")
    while True:
        yield b"1;" + b"a=b;" * 1000 + b"\r\n \r\n"


def many_fields(draw: random.Random) -> Pieces:
    """A head as large as it may be, again and again."""
    while True:
        yield head(draw, "GET", "/state", *(f"X-{number}: {'v' * 120}" for number in range(99)))


def endless_head(draw: random.Random) -> Pieces:
    """A head that never ends, a byte at a time."""
    yield b"POST /enable HTTP/1.1\r\nHost: localhost\r\nX: "
    while True:
        yield b"y"


def slow_body(draw: random.Random) -> Pieces:
    """An announced body that trickles."""
    yield head(draw, "POST", "/operations/move", "Content-Length: 16000")
    for _ in range(1000):
        yield b"["


def deep_json(draw: random.Random) -> Pieces:
    """Whole requests whose bodies are hard to read."""
    while True:
        bodies = (b"[" * 16_000, json.dumps({f"k{n}": n for n in range(1000)}).encode(), b'{"a":1,"a":2}')
        body = draw.choice(bodies)
        kind = "Content-Type: application/json"
        yield head(draw, "POST", "/operations/move", kind, f"Content-Length: {len(body)}") + body


def pipelined(draw: random.Random) -> Pieces:
    """Requests without waiting for answers."""
    while True:
        yield b"GET /state HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 200


def polled(draw: random.Random) -> Pieces:
    """Requests that may be asked, as many as there is time for; answers are read."""
    paths = ("/state", "/health", "/link", "/openapi.json", "/docs", "/programs", "/camera/latest.png")
    while True:
        yield f"GET {draw.choice(paths)} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()


def websocket(draw: random.Random) -> Pieces:
    """An upgrade that nobody offers, and frames."""
    upgrade = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13")
    yield head(draw, "GET", "/events", *upgrade, "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==")
    while True:
        yield b"\x81\xfe\xff\xff" + draw.randbytes(4096)


def silent(draw: random.Random) -> Pieces:
    """A connection, and nothing on it."""
    yield b""


def followers(draw: random.Random) -> Pieces:
    """Streams that are never read."""
    yield f"GET {draw.choice(('/events', '/camera/live'))} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()


def noise(draw: random.Random) -> Pieces:
    """What is no HTTP/1.1: TLS, HTTP/2, bytes."""
    while True:
        yield draw.choice(
            (b"\x16\x03\x01\x02\x00\x01", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", draw.randbytes(2000))
        )


def drawn(draw: random.Random) -> Pieces:
    """A request of parts by chance, and what may follow it."""
    method = draw.choice(("GET", "POST", "PUT", "HEAD", "OPTIONS", "TRACE", "get", "P" * 30))
    path = draw.choice(
        ("/state", "/stop", "/stop/x", "/operations/look", "/" + "a" * 8000, "/%00", "*", "//")
    )
    fields = draw.choices(
        ("Content-Length: 5", "Content-Length: 99999999", "Content-Length: -1", "Transfer-Encoding: chunked",
         "Transfer-Encoding: gzip, chunked", "Expect: 100-continue", "Connection: close", " folded", "X:\0",
         "Origin: http://evil.example", "Authorization: Bearer 00", "Cookie: " + "c" * 9000, "Host: evil"),
        k=draw.randrange(6),
    )  # fmt: skip
    yield head(draw, method, path, *fields)
    while True:
        yield draw.choice(
            (b"0\r\n\r\n", b"{}", b"\n", b"5\r\nhello\r\n", draw.randbytes(300), b"GET / HTTP/1.1\r\n")
        )


KINDS: dict[str, tuple[Callable[[random.Random], Pieces], int]] = {
    made.__name__: (made, connections)
    for made, connections in (
        (tiny_chunks, 24), (chunk_extensions, 24), (many_fields, 24), (endless_head, 100), (slow_body, 100),
        (deep_json, 24), (pipelined, 24), (polled, 100), (websocket, 24), (silent, 1000), (followers, 100),
        (noise, 24), (drawn, 64),
    )
}  # fmt: skip
"""Kind → what one connection sends, and how many there are at a time."""


class Attacker:
    """One connection: made anew whenever it has ended."""

    def __init__(self, port: int, pieces: Callable[[random.Random], Pieces], draw: random.Random) -> None:
        self._port, self._pieces, self._draw = port, pieces, draw
        self.sock: socket.socket | None = None
        self._left = b""

    def go_on(self, reads: bool) -> None:
        """Send what the socket takes at once, and throw away what came."""
        try:
            if self.sock is None:
                self.sock = socket.create_connection(("127.0.0.1", self._port), timeout=1.0)
                self.sock.setblocking(False)
                self._source = self._pieces(self._draw)
            self._left = self._left or next(self._source, b"")
            if self._left:
                self._left = self._left[self.sock.send(self._left[:_AT_ONCE]) :]
            if reads and not self.sock.recv(_AT_ONCE):
                raise ConnectionResetError
        except BlockingIOError:
            pass
        except OSError:
            if self.sock is not None:
                self.sock.close()
            self.sock, self._left = None, b""


def attack(port: int, kind: str, seed: int, seconds: float) -> None:
    """Send ``kind`` for so long."""
    pieces, connections = KINDS[kind]
    draw = random.Random(seed)
    attackers = [Attacker(port, pieces, draw) for _ in range(connections)]
    until_s = time.monotonic() + seconds
    pause_s = {"endless_head": 0.01, "slow_body": 0.01, "silent": 0.2, "followers": 0.2}.get(kind, 0.0)
    with contextlib.closing(selectors.DefaultSelector()):
        while time.monotonic() < until_s:
            for attacker in attackers:
                attacker.go_on(kind not in ("followers", "pipelined"))
            time.sleep(pause_s)


if __name__ == "__main__":
    attack(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), float(sys.argv[4]))
