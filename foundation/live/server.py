"""The live view: viewers subscribe to what services feed, and Prometheus asks for their figures.

It runs in a process of its own (``foundation.live``): whatever a viewer does, no loop of a service sees it.
"""

import asyncio
import contextlib
import http
import itertools
import json
import socket
from collections.abc import Collection, Iterable
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from foundation.event_log import EventLog
from foundation.live import LiveSettings, wire
from foundation.live.wire import LatestQueue
from foundation.rest.guard import Access, Guard, GuardedRequest
from foundation.rest.problems import DATA_HEADERS, MEDIA_TYPE, Refusal, RefusalLog, problem
from foundation.rest.tokens import configured_access

VIEWERS_MAX = 8
_METRICS_WITHIN_S = 3.0
_HANDSHAKE_S = 5.0
_REQUEST_BYTES = 1 << 16  # of a viewer's message


def access_of(settings: LiveSettings, setting: str) -> Access:
    """Whom the live view serves. Raises ConfigurationError as ``read_tokens`` does."""
    origins = frozenset(origin.lower() for origin in settings.allowed_origins)
    return configured_access(settings, setting)._replace(allowed_origins=origins)


class Feeder:
    """One service's connection. ``channels``: of its topics, in their order; ``ids``: their numbers."""

    def __init__(self, hello: dict[str, Any], writer: asyncio.StreamWriter, numbers: Iterable[int]) -> None:
        self.session = hello["session"]
        numbered = zip(numbers, hello["channels"], strict=False)
        self.channels: list[dict[str, Any]] = [{"id": number} | channel for number, channel in numbered]
        self.ids: list[int] = [channel["id"] for channel in self.channels]
        self._writer = writer
        self._metrics: asyncio.Queue[str] = asyncio.Queue()

    def tell_wanted(self, channels: Collection[int], new: Collection[int]) -> None:
        """Have the service feed these channels, and no others; again what it sends once of ``new``."""
        wanted, again = ([k for k, each in enumerate(self.ids) if each in of] for of in (channels, new))
        self._say({"wanted": wanted, "again": again})

    async def metrics(self) -> str:
        """What Prometheus is told of the service; empty when it does not say in time."""
        while not self._metrics.empty():  # of a time when they came too late
            self._metrics.get_nowait()
        self._say({"figures": True})
        try:
            return await asyncio.wait_for(self._metrics.get(), _METRICS_WITHIN_S)
        except TimeoutError:
            return ""

    def take_metrics(self, metrics: str) -> None:
        """It has said them."""
        self._metrics.put_nowait(metrics)

    def _say(self, hello: dict[str, Any]) -> None:
        self._writer.write(json.dumps(hello).encode() + b"\n")


class Viewer:
    """One viewer's connection. ``subscribed``: its own numbers by channel."""

    def __init__(self, connection: ServerConnection) -> None:
        self.subscribed: dict[int, int] = {}
        self._connection = connection
        self._queue: LatestQueue[bytes] = LatestQueue()
        self._texts: list[str] = []
        self._more = asyncio.Event()

    def say(self, text: str) -> None:
        """Send a text before all data."""
        self._texts.append(text)
        self._more.set()

    def show(self, channel: int, log_ns: int, data: bytes) -> None:
        """Send a message; where the viewer does not keep up, newer ones take its place."""
        number = self.subscribed.get(channel)
        if number is not None:
            self._queue.put(channel, wire.message_data(number, log_ns, data), len(data))
            self._more.set()

    async def keep_sending(self) -> None:
        """Send until cancelled, or until the connection is closed."""
        with contextlib.suppress(ConnectionClosed):
            while True:
                await self._more.wait()
                self._more.clear()
                while self._texts:
                    await self._connection.send(self._texts.pop(0))
                while not self._texts and (taken := self._queue.take()) is not None:
                    if taken[0] in self.subscribed:
                        await self._connection.send(taken[1])


class LiveServer:
    """What is served. ``name``: as viewers show it."""

    def __init__(self, access: Access, log: EventLog, name: str) -> None:
        self._name = name
        self._guard = Guard(access, RefusalLog(log))
        self._numbers = itertools.count(1)
        self._feeders: list[Feeder] = []
        self._viewers: list[Viewer] = []

    async def serve(self, listener: socket.socket) -> Server:
        """Serve at ``listener``, which is bound, until the server that is returned is closed."""
        return await serve(
            self._serve_viewer,
            sock=listener,
            process_request=self._plain_response,
            subprotocols=[Subprotocol(name) for name in wire.SUBPROTOCOLS],
            compression=None,
            open_timeout=_HANDSHAKE_S,
            max_size=_REQUEST_BYTES,
            server_header=None,
        )

    async def fed(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Take what one service feeds, until it ends."""
        feeder: Feeder | None = None
        try:
            while True:
                kind, topic, log_ns, size = wire.HEAD.unpack(await reader.readexactly(wire.HEAD.size))
                if size > wire.MOST:
                    return
                data = await reader.readexactly(size)
                if kind == wire.HELLO:
                    feeder = self._join(json.loads(data), writer)
                elif feeder is not None and kind == wire.METRICS:
                    feeder.take_metrics(data.decode())
                elif feeder is not None:
                    for viewer in self._viewers:
                        viewer.show(feeder.ids[topic], log_ns, data)
        except (asyncio.IncompleteReadError, OSError):
            return
        finally:
            self._remove_feeder(feeder)
            writer.close()

    def _join(self, hello: dict[str, Any], writer: asyncio.StreamWriter) -> Feeder:
        feeder = Feeder(hello, writer, self._numbers)
        self._feeders.append(feeder)
        self._tell(wire.advertise(feeder.channels))
        return feeder

    def _remove_feeder(self, feeder: Feeder | None) -> None:
        if feeder in self._feeders:
            self._feeders.remove(feeder)
            feeder.take_metrics("")
            for viewer in self._viewers:
                for channel in feeder.ids:
                    viewer.subscribed.pop(channel, None)
            self._tell(wire.unadvertise(feeder.ids))

    def _tell(self, text: str) -> None:
        for viewer in self._viewers:
            viewer.say(text)

    async def _serve_viewer(self, connection: ServerConnection) -> None:
        """Serve one viewer until it leaves."""
        viewer = Viewer(connection)
        self._viewers.append(viewer)
        session = self._feeders[0].session if self._feeders else ""
        viewer.say(wire.server_info(self._name, session))
        for feeder in self._feeders:
            viewer.say(wire.advertise(feeder.channels))
        sending = asyncio.create_task(viewer.keep_sending())
        try:
            async for message in connection:
                try:
                    self._subscribe(viewer, wire.subscriptions(message))
                except ValueError as error:
                    viewer.say(wire.warning(str(error)[:200]))
        except ConnectionClosed:
            pass
        finally:
            self._viewers.remove(viewer)
            sending.cancel()
            self._tell_wanted()

    def _subscribe(self, viewer: Viewer, wanted: wire.Subscriptions) -> None:
        known = {channel for feeder in self._feeders for channel in feeder.ids}
        for channel, number in list(viewer.subscribed.items()):
            if number in wanted.removed:
                del viewer.subscribed[channel]
        new = {channel: number for number, channel in wanted.added.items() if channel in known}
        viewer.subscribed |= new
        for channel in set(wanted.added.values()) - known:
            viewer.say(wire.warning(f"there is no channel {channel}"))
        self._tell_wanted(new)

    def _tell_wanted(self, new: Collection[int] = ()) -> None:
        wanted = {channel for viewer in self._viewers for channel in viewer.subscribed}
        for feeder in self._feeders:
            feeder.tell_wanted(wanted, new)

    async def _plain_response(self, connection: ServerConnection, request: Request) -> Response | None:
        """The answer to what is no viewer, or may not look; None lets the handshake go on."""
        guarded = _guarded_request(connection, request)
        refusal = self._guard.refusal(guarded)
        if refusal is None and guarded.method != "GET":
            return None  # which is answered 405
        if refusal is None and guarded.path == "/metrics":
            texts = [await feeder.metrics() for feeder in self._feeders]
            return _response(http.HTTPStatus.OK, "".join(texts).encode(), wire.MEDIA_TYPE)
        if refusal is None and guarded.path != "/":
            why = "there are / for viewers and /metrics"
            refusal = problem(http.HTTPStatus.NOT_FOUND, "request.not_found", why)
        if refusal is None and len(self._viewers) >= VIEWERS_MAX:
            why = f"{VIEWERS_MAX} viewers look already"
            refusal = problem(http.HTTPStatus.SERVICE_UNAVAILABLE, "refused.too_many_followers", why)
        return None if refusal is None else _refusal_response(refusal)


def _guarded_request(connection: ServerConnection, request: Request) -> GuardedRequest:
    """A handshake as our guard of HTTP reads requests."""
    fields = [(name.lower().encode(), value.encode("latin-1")) for name, value in request.headers.raw_items()]
    client, server = connection.remote_address[0], connection.local_address[0]
    return GuardedRequest(request.method, request.path.partition("?")[0], fields, client, server)


def _refusal_response(refusal: Refusal) -> Response:
    status = http.HTTPStatus(refusal["status"])
    response = _response(status, json.dumps(refusal).encode(), MEDIA_TYPE)
    if status == http.HTTPStatus.UNAUTHORIZED:
        response.headers["WWW-Authenticate"] = 'Bearer realm="longreach"'
        response.headers["WWW-Authenticate"] = 'Basic realm="longreach", charset="UTF-8"'
    return response


def _response(status: http.HTTPStatus, body: bytes, media_type: str) -> Response:
    hello = DATA_HEADERS | {
        "Content-Type": media_type,
        "Content-Length": str(len(body)),
        "Connection": "close",
    }
    return Response(status.value, status.phrase, Headers(**hello), body)
