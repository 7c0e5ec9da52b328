"""A flood of datagrams on one port: ``python -m tests.integration.flood PORT RATE SECONDS``."""

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from tests.support.paths import ROOT

_BATCH = 50


def flood(port: int, rate_hz: float, seconds: float) -> float:
    """The rate reached (1/s) with datagrams of 112 bytes that look like a reference until their sum."""
    data = b"LRLK\x01\x00\x05" + bytes(105)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setblocking(False)
        sock.connect(("127.0.0.1", port))
        began = time.monotonic()
        sent = 0
        while (elapsed := time.monotonic() - began) < seconds:
            if sent > elapsed * rate_hz:
                time.sleep(0.0005)
                continue
            for _ in range(_BATCH):
                try:
                    sock.send(data)
                except (BlockingIOError, ConnectionRefusedError):
                    continue
            sent += _BATCH
        return sent / elapsed


@contextmanager
def flooding(port: int, rate_hz: float, seconds: float) -> Iterator[None]:
    """A flood while the block lasts, for ``seconds`` at most; prints the rate that it reached."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.integration.flood", str(port), str(rate_hz), str(seconds)],
        cwd=ROOT,
    )
    try:
        yield
    finally:
        process.wait(seconds + 10.0)


if __name__ == "__main__":
    reached = flood(int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]))
    print(f"flood: {reached:.0f} datagrams a second on port {sys.argv[1]}", flush=True)
