"""What strangers send to the listeners of the three services; each attack counts what it got.

An attack runs in a process of its own, and only against addresses of this machine.
"""

import select
import selectors
import socket
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

from protocol.datagram import Header, encode
from protocol.reference_messages import Hello

_TURN_S = 0.05
_READ_WORD = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 0, 1)
_HALF_FRAME = _READ_WORD[:7]


class Listeners(NamedTuple):
    """Host and port of each listener."""

    rest: tuple[str, int]
    faults: tuple[str, int]
    fieldbus: tuple[str, int]
    camera: tuple[str, int]
    reference: tuple[str, int]


Counts = Counter[str]
Attack = Callable[[Listeners, float], Counts]


@contextmanager
def _connections(address: tuple[str, int], count: int, counts: Counts) -> Iterator[list[socket.socket]]:
    """Up to ``count`` open connections; those refused are counted."""
    with ExitStack() as stack:
        opened = []
        for _ in range(count):
            try:
                opened.append(stack.enter_context(socket.create_connection(address, timeout=2.0)))
            except OSError:
                counts["not connected"] += 1
        yield opened


def _post(host: str, path: str, length: str, content_type: str = "application/json") -> bytes:
    head = f"POST {path} HTTP/1.1\r\nHost: {host}\r\nContent-Type: {content_type}\r\n{length}\r\n\r\n"
    return head.encode()


def _status(answer: bytes) -> str:
    words = answer.split(b" ", 2)
    return words[1].decode("ascii", "replace") if len(words) > 1 else "closed"


def _send_body(address: tuple[str, int], head: bytes, chunk: bytes, chunks: int) -> str:
    """The status that answers a long body; "closed" if the connection was ended without one."""
    with socket.create_connection(address, timeout=2.0) as connection:
        try:
            connection.sendall(head)
            for _ in range(chunks):
                connection.sendall(chunk)
        except OSError:
            pass  # refused midway: the answer may be there
        try:
            return _status(connection.recv(4096))
        except OSError:
            return "closed"


def _bodies(address: tuple[str, int], path: str, seconds: float, member: bytes) -> Counts:
    """50 MB of JSON in one request after another."""
    counts: Counts = Counter()
    chunk = member * (1_000_000 // len(member))
    head = _post(address[0], path, "Content-Length: 50000000")
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        try:
            counts[_send_body(address, head, chunk, 50)] += 1
        except OSError:
            counts["not connected"] += 1
    return counts


def large_bodies_to_faults(targets: Listeners, seconds: float) -> Counts:
    """50 MB in one string to the fault API."""
    return _bodies(targets.faults, "/faults", seconds, b"x")


def many_members_to_faults(targets: Listeners, seconds: float) -> Counts:
    """50 MB of small members to the fault API."""
    return _bodies(targets.faults, "/faults", seconds, b'"a":1,')


def large_bodies_to_rest(targets: Listeners, seconds: float) -> Counts:
    """50 MB in one string to the vision PC's API."""
    return _bodies(targets.rest, "/operations/look", seconds, b"x")


def chunked_bodies_to_rest(targets: Listeners, seconds: float) -> Counts:
    """50 MB in chunks, of no stated length, to the vision PC's API."""
    counts: Counts = Counter()
    head = _post(targets.rest[0], "/operations/look", "Transfer-Encoding: chunked")
    chunk = b"%x\r\n" % 1_000_000 + b"x" * 1_000_000 + b"\r\n"
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        try:
            counts[_send_body(targets.rest, head, chunk, 50)] += 1
        except OSError:
            counts["not connected"] += 1
    return counts


def _hold_connections(address: tuple[str, int], count: int, first: bytes, seconds: float) -> Counts:
    """``count`` connections that send ``first`` and then nothing, and never read."""
    counts: Counts = Counter()
    until_s = time.monotonic() + seconds
    with _connections(address, count, counts) as opened:
        for connection in opened:
            try:
                connection.sendall(first)
            except OSError:
                counts["closed"] += 1
        time.sleep(max(until_s - time.monotonic(), 0.0))
        for connection in opened:
            connection.setblocking(False)
            try:
                answer = connection.recv(4096)
                counts[_status(answer) if answer.startswith(b"HTTP/") or not answer else "answered"] += 1
            except BlockingIOError:
                counts["held"] += 1
            except OSError:
                counts["closed"] += 1
    return counts


def half_requests_to_faults(targets: Listeners, seconds: float) -> Counts:
    """500 requests to the fault API of which only the head and half a body come."""
    head = _post(targets.faults[0], "/faults", "Content-Length: 1000")
    return _hold_connections(targets.faults, 500, head + b'{"fault"', seconds)


def half_requests_to_rest(targets: Listeners, seconds: float) -> Counts:
    """500 half-open requests to the vision PC's API."""
    return _hold_connections(targets.rest, 500, b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\nX-", seconds)


def half_frames_to_fieldbus(targets: Listeners, seconds: float) -> Counts:
    """200 half frames to the fieldbus."""
    return _hold_connections(targets.fieldbus, 200, _HALF_FRAME, seconds)


def idle_fieldbus_connections(targets: Listeners, seconds: float) -> Counts:
    """1500 connections to the fieldbus that send nothing."""
    return _hold_connections(targets.fieldbus, 1500, b"", seconds)


def noise_to_camera(targets: Listeners, seconds: float) -> Counts:
    """300 clients of the camera stream that send 200 KB of noise between them and never read."""
    return _hold_connections(targets.camera, 300, bytes(range(256)) * 3, seconds)


def followers(targets: Listeners, seconds: float) -> Counts:
    """1000 followers of one operation."""
    host, port = targets.rest
    newest = _newest_operation(targets.rest)
    request = f"GET /operations/{newest}/events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode()
    return _hold_connections(targets.rest, 1000, request, seconds)


def _newest_operation(address: tuple[str, int]) -> str:
    with socket.create_connection(address, timeout=2.0) as connection:
        connection.sendall(f"GET /operations HTTP/1.0\r\nHost: {address[0]}\r\n\r\n".encode())
        said = b""
        while part := connection.recv(65_536):
            said += part
    ids = said.rpartition(b'"id":"')[2].partition(b'"')[0]
    return ids.decode()


def _pollers(address: tuple[str, int], path: str, clients: int, rate_hz: float, seconds: float) -> Counts:
    """``clients`` that ask again as soon as they are answered, or at ``rate_hz`` each."""
    counts: Counts = Counter()
    request = f"GET {path} HTTP/1.1\r\nHost: {address[0]}\r\n\r\n".encode()
    until_s = time.monotonic() + seconds
    with _connections(address, clients, counts) as opened, selectors.DefaultSelector() as selector:
        due_s = dict.fromkeys(opened, 0.0)
        waiting: set[socket.socket] = set()
        for connection in opened:
            selector.register(connection, selectors.EVENT_READ)
        while time.monotonic() < until_s and due_s:
            now_s = time.monotonic()
            for connection, at_s in due_s.items():
                if connection not in waiting and at_s <= now_s:
                    connection.sendall(request)
                    waiting.add(connection)
                    due_s[connection] = now_s + (1.0 / rate_hz if rate_hz else 0.0)
            for key, _ in selector.select(0.002):
                connection = key.fileobj  # type: ignore[assignment]
                answer = connection.recv(262_144)
                if not answer:
                    selector.unregister(connection)
                    del due_s[connection]
                    counts["closed"] += 1
                elif answer.startswith(b"HTTP"):
                    counts[_status(answer)] += 1
                    waiting.discard(connection)
    return counts


def pollers_of_kinds(targets: Listeners, seconds: float) -> Counts:
    """4 clients that read the kinds of faults without a pause."""
    return _pollers(targets.faults, "/faults/kinds", 4, 0.0, seconds)


def pollers_of_state(targets: Listeners, seconds: float) -> Counts:
    """8 clients that read the state at 100 Hz each."""
    return _pollers(targets.rest, "/state", 8, 100.0, seconds)


def pipelined_requests(targets: Listeners, seconds: float) -> Counts:
    """One client that sends requests for the state without waiting for answers, which it reads."""
    counts: Counts = Counter()
    batch = f"GET /state HTTP/1.1\r\nHost: {targets.rest[0]}\r\n\r\n".encode() * 400
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        try:
            with socket.create_connection(targets.rest, timeout=2.0) as connection:
                counts["connected"] += 1
                _pipeline(connection, batch, until_s, counts)
        except OSError:
            counts["closed"] += 1
    return counts


def _pipeline(connection: socket.socket, batch: bytes, until_s: float, counts: Counts) -> None:
    """Send ``batch`` again and again, and read; raises OSError when the connection ends."""
    connection.setblocking(False)
    while time.monotonic() < until_s:
        readable, writable, _ = select.select([connection], [connection], [], 0.1)
        if readable:
            answers = connection.recv(1 << 20)
            if not answers:
                raise ConnectionResetError
            counts["answers"] += answers.count(b"HTTP/1.1 ")
        if writable:
            connection.send(batch)


def requests_ahead(targets: Listeners, seconds: float) -> Counts:
    """16 clients that always have a thousand requests for the state under way: fewer bytes than end one."""
    counts: Counts = Counter()
    request = f"GET /state HTTP/1.1\r\nHost: {targets.rest[0]}\r\n\r\n".encode()
    until_s = time.monotonic() + seconds
    with _connections(targets.rest, 16, counts) as opened, selectors.DefaultSelector() as selector:
        for connection in opened:
            connection.sendall(request * 1000)
            selector.register(connection, selectors.EVENT_READ)
        while time.monotonic() < until_s and selector.get_map():
            for key, _ in selector.select(0.1):
                connection = key.fileobj  # type: ignore[assignment]
                said = connection.recv(262_144)
                answers = said.count(b"HTTP/1.1 ")
                counts["answers"] += answers
                if said:
                    connection.sendall(request * answers)
                else:
                    selector.unregister(connection)
                    counts["closed"] += 1
    return counts


def fieldbus_unread(targets: Listeners, seconds: float) -> Counts:
    """One fieldbus connection that sends reads without a pause and never reads an answer."""
    counts: Counts = Counter()
    batch = _READ_WORD * 500
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        try:
            with socket.create_connection(targets.fieldbus, timeout=0.5) as connection:
                counts["connected"] += 1
                while time.monotonic() < until_s:
                    connection.sendall(batch)
                    counts["requests"] += 500
        except TimeoutError:
            counts["no longer read"] += 1
        except OSError:
            counts["closed"] += 1
            time.sleep(_TURN_S)
    return counts


def fieldbus_at_full_speed(targets: Listeners, seconds: float) -> Counts:
    """4 fieldbus masters that read without a pause."""
    counts: Counts = Counter()
    until_s = time.monotonic() + seconds
    with _connections(targets.fieldbus, 4, counts) as opened, selectors.DefaultSelector() as selector:
        for connection in opened:
            connection.sendall(_READ_WORD)
            selector.register(connection, selectors.EVENT_READ)
        while time.monotonic() < until_s and selector.get_map():
            for key, _ in selector.select(0.1):
                connection = key.fileobj  # type: ignore[assignment]
                if connection.recv(4096):
                    counts["answers"] += 1
                    connection.sendall(_READ_WORD)
                else:
                    selector.unregister(connection)
                    counts["closed"] += 1
    return counts


def datagrams_of_strangers(targets: Listeners, seconds: float) -> Counts:
    """20,000 datagrams a second to the reference link: noise, and HELLO of another client in turns."""
    counts: Counts = Counter()
    until_s = time.monotonic() + seconds
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.connect(targets.reference)
        stranger.setblocking(False)
        while time.monotonic() < until_s:
            begin_s = time.monotonic()
            for number in range(200):
                now_ns = time.monotonic_ns()
                hello = encode(Hello(now_ns, 1, 0, 0), Header(0, number, now_ns))
                try:
                    stranger.send(hello if number % 2 else b"LRLK" + hello[8:])
                    counts["datagrams"] += 1
                except OSError:
                    counts["not sent"] += 1
            try:
                while stranger.recv(2048):
                    counts["answers"] += 1
            except OSError:
                pass
            time.sleep(max(begin_s + 0.01 - time.monotonic(), 0.0))
    return counts


ATTACKS: dict[str, Attack] = {
    "none": lambda targets, seconds: Counter(),
    **{
        attack.__name__.replace("_", "-"): attack
        for attack in (
            large_bodies_to_faults, many_members_to_faults, half_requests_to_faults, pollers_of_kinds,
            fieldbus_unread, fieldbus_at_full_speed, half_frames_to_fieldbus, idle_fieldbus_connections,
            noise_to_camera, datagrams_of_strangers,
            followers, half_requests_to_rest, large_bodies_to_rest, chunked_bodies_to_rest, pollers_of_state,
            pipelined_requests, requests_ahead,
        )
    },
}  # fmt: skip
"""Name → attack; ``none`` is the comparison."""
