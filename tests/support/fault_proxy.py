"""A TCP proxy between two peers; a script decides what becomes of each packet."""

import asyncio
import contextlib
import socket
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import NamedTuple

MS = 1_000_000
_CHUNK_BYTES = 65_536


class Delivery(NamedTuple):
    """Bytes to hand on after ``delay_ns``."""

    delay_ns: int
    data: bytes


Script = Callable[[bytes, int], list[Delivery]]


class Direction:
    """One direction. Its script decides about each packet by its number since the script began."""

    def __init__(self) -> None:
        self.script: Script | None = None
        self.packets = 0

    def begin(self, script: Script | None) -> None:
        """From now on ``script`` decides; None: everything passes."""
        self.script, self.packets = script, 0

    def fate(self, data: bytes) -> list[Delivery]:
        """The deliveries that ``data`` becomes; empty: lost."""
        self.packets += 1
        return [Delivery(0, data)] if self.script is None else self.script(data, self.packets)


class TcpProxy:
    """Stands before ``server_port`` of this machine. What arrives at once is one packet, in order."""

    def __init__(self, server_port: int) -> None:
        self.requests, self.answers = Direction(), Direction()
        self.port = 0
        self._server_port = server_port
        self._tasks: set[asyncio.Task[None]] = set()
        self._writers: set[asyncio.StreamWriter] = set()

    @asynccontextmanager
    async def serving(self) -> AsyncIterator["TcpProxy"]:
        """Listen on any port until the block ends."""
        server = await asyncio.start_server(self._accept, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        try:
            yield self
        finally:
            server.close()
            for task in tuple(self._tasks):
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            await server.wait_closed()

    def reset(self) -> None:
        """Break every connection off, as a device that restarts: both ends get a TCP reset."""
        for writer in tuple(self._writers):
            sock = writer.get_extra_info("socket")
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            writer.transport.abort()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        try:
            up_reader, up_writer = await asyncio.open_connection("127.0.0.1", self._server_port)
        except OSError:
            writer.close()
            return
        ends = {writer, up_writer}
        self._writers |= ends
        both = [
            asyncio.ensure_future(_pump(reader, up_writer, self.requests)),
            asyncio.ensure_future(_pump(up_reader, writer, self.answers)),
        ]
        try:
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for pump in both:
                pump.cancel()
            await asyncio.gather(*both, return_exceptions=True)
            self._writers -= ends
            for each in ends:
                each.close()
                with contextlib.suppress(OSError):
                    await each.wait_closed()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, direction: Direction) -> None:
    queue: asyncio.Queue[tuple[float, bytes] | None] = asyncio.Queue()
    loop = asyncio.get_running_loop()

    async def deliver() -> None:
        with contextlib.suppress(OSError):
            while (item := await queue.get()) is not None:
                due_s, data = item
                await asyncio.sleep(due_s - loop.time())
                writer.write(data)
                await writer.drain()

    sender = asyncio.ensure_future(deliver())
    try:
        with contextlib.suppress(OSError):
            while data := await reader.read(_CHUNK_BYTES):
                for delivery in direction.fate(data):
                    queue.put_nowait((loop.time() + 1e-9 * delivery.delay_ns, delivery.data))
        queue.put_nowait(None)
        await sender
    finally:
        sender.cancel()
