"""Requests from bytes: each is a request, the beginning of one, or refused; h11 reads the same in it."""

import random
import time

import h11
import pytest

from foundation.rest.door import IDLE_S
from foundation.rest.http_messages import (
    Head,
    RequestUnreadable,
    take_body,
    take_head,
)
from tests.support.hostile_http import KINDS

PARTS = (
    b"GET", b"POST", b" ", b"  ", b"\t", b"/", b"/stop", b"*", b"http://localhost/x?y", b"HTTP/1.1",
    b"HTTP/1.0",
    b"HTTP/1.2", b"\r\n", b"\n", b"\r", b"\r\n\r\n", b"Host", b":", b"localhost", b"Content-Length: 5",
    b"Content-Length: +5", b"Content-Length: 5, 5", b"Transfer-Encoding: chunked", b"\0", b"\xff", b"a" * 300,
    b"Host : localhost", b"Connection: close", b"Expect: 100-continue", b"hello",
)  # fmt: skip


def read(data: bytes) -> tuple[Head, bytes] | None:
    """The request at the beginning; None: none, or not whole."""
    received = bytearray(data)
    try:
        head = take_head(received)
        body = None if head is None else take_body(received, head.length)
    except RequestUnreadable:
        return None
    return None if head is None or body is None else (head, body)


def inputs(draw: random.Random) -> bytes:
    """Parts by chance, often around a request that is right."""
    parts = [b"POST /x HTTP/1.1", b"Host: localhost", b"Content-Length: 5", b"", b"hello"]
    for _ in range(draw.randrange(4)):
        parts[draw.randrange(len(parts))] = b"".join(draw.choices(PARTS, k=draw.randrange(1, 4)))
    return b"\r\n".join(parts)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_read_as_a_request_is_the_same_request_to_h11(seed: int) -> None:
    draw, requests = random.Random(seed), 0
    for _ in range(500):
        found = read(inputs(draw))
        if found is None:
            continue
        requests += 1
        head, body = found
        other = h11.Connection(h11.SERVER)
        other.receive_data(head.forwarded(body, longreach_role="look"))
        request = other.next_event()
        assert isinstance(request, h11.Request)
        assert request.method == head.method.encode()
        assert request.target == head.target.encode()
        assert (b"longreach-role", b"look") in list(request.headers)
        said = b""
        while isinstance(event := other.next_event(), h11.Data):
            said += event.data
        assert (said, type(event)) == (body, h11.EndOfMessage)
    assert requests > 20


@pytest.mark.parametrize("kind", KINDS)
def test_no_beginning_takes_long_to_read(kind: str) -> None:
    """The loop that reads it may have a stop to serve: 5 ms, here in processor time."""
    data = b"".join(piece for piece, _ in zip(KINDS[kind][0](random.Random(1)), range(20), strict=False))[
        :70_000
    ]
    longest_s = 0.0
    for size in range(0, len(data), max(len(data) // 50, 1)):
        began_s = time.thread_time()
        read(data[:size])
        longest_s = max(longest_s, time.thread_time() - began_s)
    assert longest_s < 0.005


def test_an_idle_connection_outlives_that_of_a_proxy() -> None:
    """nginx and the load balancers of clouds keep one for 60 to 75 s: who ends it first loses no request."""
    assert IDLE_S > 75.0
