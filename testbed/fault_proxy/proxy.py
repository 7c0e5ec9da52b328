"""The proxy's sockets: UDP with a port of its own for every client, TCP with a stream each way."""

import asyncio
import contextlib
import json
import signal
import socket
import struct
from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, NamedTuple, cast

import typer

from foundation.command_options import unfolded
from foundation.secret_source import known_host
from protocol.errors import ConfigurationError
from testbed.fault_proxy.faults import Delivery, FaultLine, Faults

_CHUNK_BYTES = 65_536
_MAX_CLIENTS = 256


class Route(NamedTuple):
    """Where the proxy listens (port 0: any) and whom it stands in front of."""

    listen_port: Annotated[int, typer.Option(min=0, max=65535, help="Where to listen; 0: any port.")]
    port: Annotated[int, typer.Option(min=1, max=65535, help="The port stood in front of.")]
    host: Annotated[str, typer.Option(help="The host stood in front of.")] = "127.0.0.1"
    listen_host: Annotated[str, typer.Option(help="The address to listen on.")] = "127.0.0.1"


class FaultProxy(ABC):
    """Both directions of one proxied service; ``port`` is where it listens once it has started.

    ``to_server`` and ``to_client`` decide and count; the same seed gives the n-th packet of a direction the
    same fate. Use it as ``async with``.
    """

    port: int

    def __init__(self, route: Route, to_server: Faults, to_client: Faults, seed: int) -> None:
        self.route = route
        self.to_server = FaultLine(to_server, seed, 0)
        self.to_client = FaultLine(to_client, seed, 1)
        self._began_ns = 0
        self._loop = cast(asyncio.AbstractEventLoop, None)

    async def __aenter__(self) -> "FaultProxy":
        self._loop = asyncio.get_running_loop()
        self._began_ns = self._now_ns()
        await self._open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._close()

    def statistics(self) -> dict[str, dict[str, int]]:
        """Counts by direction."""
        return {"to_server": self.to_server.as_dict(), "to_client": self.to_client.as_dict()}

    @abstractmethod
    async def _open(self) -> None:
        """Listen, and set ``port``."""

    @abstractmethod
    async def _close(self) -> None:
        """Stop listening, and end what is under way."""

    def _now_ns(self) -> int:
        return round(self._loop.time() * 1e9)

    def _fate(self, line: FaultLine, data: bytes) -> list[Delivery]:
        return line.fate(data, self._now_ns() - self._began_ns)


class UdpProxy(FaultProxy):
    """Datagrams; the server sees each client under a port of its own. Raises OSError for a port in use."""

    async def _open(self) -> None:
        self._upstream: dict[Any, asyncio.DatagramTransport] = {}
        self._opening: dict[Any, list[Delivery]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._listener, _ = await self._loop.create_datagram_endpoint(
            lambda: _Datagrams(self._from_client),
            local_addr=(self.route.listen_host, self.route.listen_port),
        )
        self.port = self._listener.get_extra_info("sockname")[1]

    async def _close(self) -> None:
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._listener.close()
        for transport in self._upstream.values():
            transport.close()
        await asyncio.sleep(0)

    def _from_client(self, data: bytes, client: Any) -> None:
        deliveries = self._fate(self.to_server, data)
        if client in self._upstream:
            self._send_up(client, deliveries)
        elif client in self._opening:
            self._opening[client] += deliveries
        elif len(self._upstream) + len(self._opening) < _MAX_CLIENTS:
            self._opening[client] = deliveries
            task = self._loop.create_task(self._connect(client))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _connect(self, client: Any) -> None:
        transport, _ = await self._loop.create_datagram_endpoint(
            lambda: _Datagrams(lambda data, _: self._from_server(data, client)),
            remote_addr=(self.route.host, self.route.port),
        )
        self._upstream[client] = transport
        self._send_up(client, self._opening.pop(client))

    def _send_up(self, client: Any, deliveries: list[Delivery]) -> None:
        for delay_ns, data in deliveries:
            self._loop.call_later(delay_ns * 1e-9, self._upstream[client].sendto, data)

    def _from_server(self, data: bytes, client: Any) -> None:
        for delay_ns, delivered in self._fate(self.to_client, data):
            self._loop.call_later(delay_ns * 1e-9, self._listener.sendto, delivered, client)


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, take: Any) -> None:
        self._take = take

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._take(data, addr)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there yet: a datagram more that is lost."""


class TcpProxy(FaultProxy):
    """Streams. What arrives at once is one packet; bytes stay in order, so that reordering is only delay.

    A loss or a truncation leaves a hole in the stream, which TCP itself would not: it is what a broken device
    between the two does. Half-open: the connections stay up and carry nothing.
    """

    async def _open(self) -> None:
        self._pumps: set[asyncio.Task[None]] = set()
        self._writers: set[asyncio.StreamWriter] = set()
        self._server = await asyncio.start_server(
            self._accept, self.route.listen_host, self.route.listen_port
        )
        self.port = self._server.sockets[0].getsockname()[1]

    async def _close(self) -> None:
        self._server.close()
        for task in tuple(self._pumps):
            task.cancel()
        await asyncio.gather(*self._pumps, return_exceptions=True)
        await self._server.wait_closed()

    def reset(self) -> None:
        """Break every connection off at once, as a device that restarts: both ends get a TCP reset."""
        for writer in tuple(self._writers):
            sock = writer.get_extra_info("socket")
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            writer.transport.abort()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._pumps.add(task)
        task.add_done_callback(self._pumps.discard)
        try:
            up_reader, up_writer = await asyncio.open_connection(self.route.host, self.route.port)
        except OSError:
            writer.close()
            return
        ends = {writer, up_writer}
        self._writers |= ends
        both = [
            asyncio.ensure_future(self._pump(reader, up_writer, self.to_server)),
            asyncio.ensure_future(self._pump(up_reader, writer, self.to_client)),
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

    async def _pump(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, line: FaultLine
    ) -> None:
        queue: asyncio.Queue[tuple[int, bytes] | None] = asyncio.Queue()
        sender = asyncio.ensure_future(self._deliver(queue, writer))
        try:
            with contextlib.suppress(OSError):
                while data := await reader.read(_CHUNK_BYTES):
                    for delay_ns, delivered in self._fate(line, data):
                        queue.put_nowait((self._now_ns() + delay_ns, delivered))
            queue.put_nowait(None)
            await sender
        finally:
            sender.cancel()

    async def _deliver(
        self, queue: "asyncio.Queue[tuple[int, bytes] | None]", writer: asyncio.StreamWriter
    ) -> None:
        with contextlib.suppress(OSError):
            while (item := await queue.get()) is not None:
                due_ns, data = item
                wait_ns = due_ns - self._now_ns()
                if wait_ns > 0:
                    await asyncio.sleep(wait_ns * 1e-9)
                writer.write(data)
                await writer.drain()


@unfolded
def proxy(
    route: Route,
    faults: Faults,
    tcp: Annotated[bool, typer.Option("--tcp", help="Streams instead of datagrams.")] = False,
    only: Annotated[str, typer.Option(help="both, to-server or to-client.")] = "both",
    seed: Annotated[int, typer.Option(min=0, help="The same seed is the same fate.")] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the counts to this file.")] = None,
) -> None:
    """Stand between two peers and lose, delay, reorder, cut or bend what passes, until Ctrl-C."""
    if only not in ("both", "to-server", "to-client"):
        raise ConfigurationError("proxy.direction", f"--only {only}: wanted both, to-server or to-client")
    known_host(route.host)
    up, down = (faults if only in ("both", way) else Faults() for way in ("to-server", "to-client"))
    kind = TcpProxy if tcp else UdpProxy
    counts = asyncio.run(_serve(kind(route, up, down, seed)))
    text = json.dumps(counts)
    typer.echo(text)
    if json_file is not None:
        json_file.write_text(text + "\n")


async def _serve(chosen: FaultProxy) -> dict[str, dict[str, int]]:
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    where = f"{chosen.route.listen_host}:{chosen.route.listen_port}"
    try:
        async with chosen:
            typer.echo(json.dumps({"event": "ready", "service": "fault_proxy", "port": chosen.port}))
            await stop.wait()
    except OSError as error:
        raise ConfigurationError("configuration.port_busy", f"{where}: {error.strerror}") from error
    return chosen.statistics()
