"""Signs of life to whoever started a service, as systemd has them (sd_notify), from the loop that serves.

``NOTIFY_SOCKET`` in the environment names the socket, ``WATCHDOG_USEC`` the longest silence; without the
first nothing is sent. A loop that is stopped, stuck or starved is silent, whatever its process does.
"""

import asyncio
import os
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress

SOCKET, LONGEST_SILENCE = "NOTIFY_SOCKET", "WATCHDOG_USEC"
_PERIOD_S = 0.5
_ALIVE = b"WATCHDOG=1"


@asynccontextmanager
async def signs_of_life(environment: Mapping[str, str] = os.environ) -> AsyncIterator[None]:
    """Give signs of life from the running loop within the block, if somebody asked for them."""
    address = environment.get(SOCKET)
    if not address:
        yield
        return
    task = asyncio.get_running_loop().create_task(_keep_telling(address, _period_s(environment)))
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def _keep_telling(address: str, period_s: float) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as teller:
        while True:
            with suppress(OSError):  # who asked may have gone, or be slow: that is no trouble of the service
                teller.sendto(_ALIVE, "\0" + address[1:] if address.startswith("@") else address)
            await asyncio.sleep(period_s)


def _period_s(environment: Mapping[str, str]) -> float:
    """Half of the longest silence, as systemd recommends."""
    longest_us = environment.get(LONGEST_SILENCE, "")
    return 0.5e-6 * int(longest_us) if longest_us.isdigit() and int(longest_us) else _PERIOD_S


class Listener:
    """The other side: the socket of one service. Silence is counted from when it was made."""

    def __init__(self, name: str, now_ns: int) -> None:
        """``name``: of an abstract socket: no file is left behind. Raises OSError when it is taken."""
        self.address = f"@{name}"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind("\0" + name)
        self._heard_ns = now_ns

    def silence_ns(self, now_ns: int) -> int:
        """How long nothing has come."""
        with suppress(OSError):  # nothing there, or closed
            while self._socket.recv(64):
                self._heard_ns = now_ns
        return now_ns - self._heard_ns

    def count_from(self, now_ns: int) -> None:
        """Count silence from now on: what was before is no stall."""
        self._heard_ns = now_ns

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
