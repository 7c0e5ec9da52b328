"""A service, its live face, and viewers of others' making: on real sockets, in this process."""

import asyncio
import io
import json
import os
import socket
import struct
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import NamedTuple

import httpx
import pytest
from websockets.exceptions import InvalidStatus

from foundation.event_log import EventLog
from foundation.live import LiveSettings, wire
from foundation.live.feed import LiveFeed
from foundation.live.server import VIEWERS_MAX, LiveServer, access_of
from foundation.recording.mcap_file import Entries, Topic
from foundation.recording.messages import MessageField, RecordSink, format_of, message_class
from foundation.rest.guard import ANYBODY_HERE, Access, Role
from tests.foundation.live.viewing import WITHIN_S, watching

pytestmark = pytest.mark.realtime

Number = message_class("Number", (MessageField("value", "int64"), MessageField("filling", "bytes")))
ENTRIES: Entries = {"session": {"id": "of the test"}}
MOVING, SILENT, ONCE = "/moving", "/silent", "/once"


class Rig(NamedTuple):
    feed: LiveFeed
    sink: RecordSink
    port: int
    encoded: list[str]


@asynccontextmanager
async def fed(tmp_path: Path, access: Access = ANYBODY_HERE, *, recorded: bool = False) -> AsyncIterator[Rig]:
    """A service that feeds a face; ``encoded`` are the topics of messages that were encoded."""
    encoded: list[str] = []

    def topic(name: str, *, once: bool = False) -> Topic:
        def encode(value: int) -> bytes:
            encoded.append(name)
            return bytes(Number(value=value).SerializeToString())

        return Topic(name, format_of(Number), encode, once=once)

    async with AsyncExitStack() as stack:
        log = EventLog("test", io.StringIO())
        stack.callback(log.close)
        feed = LiveFeed("tested", log, str(tmp_path / "feeds"), lambda: "longreach_tested 1\n")
        listener = socket.create_server(("127.0.0.1", 0))
        face = LiveServer(access, log, "longreach tested")
        await stack.enter_async_context(await face.serve(listener))
        await stack.enter_async_context(await asyncio.start_unix_server(face.fed, tmp_path / "feeds"))
        topics = (topic(MOVING), topic(SILENT), topic(ONCE, once=True))
        sink = feed.opened(recorded)(tmp_path / "f.mcap", topics, ENTRIES)
        try:
            yield Rig(feed, sink, listener.getsockname()[1], encoded)
        finally:
            await asyncio.to_thread(sink.close)
            await asyncio.to_thread(feed.close)


async def wanted(rig: Rig, topic: int, *, is_wanted: bool = True) -> None:
    async with asyncio.timeout(WITHIN_S):
        while rig.feed.wants(topic) != is_wanted:  # noqa: ASYNC110  another thread's
            await asyncio.sleep(0.005)


@pytest.mark.parametrize("recorded", [False, True])
@pytest.mark.parametrize("subprotocol", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
async def test_a_viewer_is_shown_what_it_asked_for(tmp_path: Path, subprotocol: str, recorded: bool) -> None:
    async with fed(tmp_path, recorded=recorded) as rig, watching(rig.port, subprotocol) as viewer:
        await viewer.until(lambda each: len(each.channels) == 3)
        assert viewer.info["name"] == "longreach tested"
        await viewer.subscribe(MOVING)
        await wanted(rig, 0)
        for value in range(3):
            rig.sink.put(0, value, 1000 + value, 5)
            rig.sink.put(1, value, 1000 + value, 5)
        await viewer.until(lambda each: len(each.shown) == 3)
        assert [(each.topic, each.log_ns, each.message.value) for each in viewer.shown] == [
            (MOVING, 1000 + value, value) for value in range(3)
        ]
        await viewer.unsubscribe(MOVING)
        await wanted(rig, 0, is_wanted=False)


async def test_what_nobody_looks_at_is_not_encoded(tmp_path: Path) -> None:
    async with fed(tmp_path) as rig:
        for value in range(100):
            rig.sink.put(0, value, value, value)
        async with watching(rig.port) as viewer:
            await viewer.until(lambda each: len(each.channels) == 3)
            await viewer.subscribe(SILENT)
            await wanted(rig, 1)
            rig.sink.put(1, 7, 7, 7)
            await viewer.until(lambda each: len(each.shown) == 1)
        await wanted(rig, 1, is_wanted=False)
        assert rig.encoded == [SILENT]


async def test_a_recorded_message_is_encoded_once_for_all(tmp_path: Path) -> None:
    async with fed(tmp_path, recorded=True) as rig, watching(rig.port) as one, watching(rig.port) as other:
        for viewer in (one, other):
            await viewer.until(lambda each: len(each.channels) == 3)
            await viewer.subscribe(MOVING)
        await wanted(rig, 0)
        rig.sink.put(0, 3, 3, 3)
        await one.until(lambda each: len(each.shown) == 1)
        rig.sink.put(0, 4, 4, 4)  # by then both have asked
        await other.until(lambda each: bool(each.shown) and each.shown[-1].message.value == 4)
        assert rig.encoded == [MOVING, MOVING]


async def test_who_comes_late_is_shown_what_is_sent_once(tmp_path: Path) -> None:
    async with fed(tmp_path) as rig:
        rig.sink.put(2, 42, 9, 9)
        for _ in range(2):  # the second is shown what the face kept
            async with watching(rig.port) as viewer:
                await viewer.until(lambda each: len(each.channels) == 3)
                await viewer.subscribe(ONCE)
                await viewer.until(lambda each: len(each.shown) == 1)
                assert viewer.shown[0].message.value == 42


async def test_a_viewer_that_does_not_read_holds_up_nobody(tmp_path: Path) -> None:
    async with fed(tmp_path, recorded=True) as rig, watching(rig.port, max_queue=1) as slow:
        await slow.until(lambda each: len(each.channels) == 3)
        await slow.subscribe(MOVING)
        await wanted(rig, 0)
        filling = b"x" * 200_000
        topic_bytes = Number(filling=filling).SerializeToString()
        for value in range(200):  # 40 MB that it does not read
            rig.feed.offer(0, bytes(topic_bytes), value)
        async with watching(rig.port) as quick:
            await quick.until(lambda each: len(each.channels) == 3)
            await quick.subscribe(SILENT)
            await wanted(rig, 1)
            rig.sink.put(1, 5, 5, 5)
            await quick.until(lambda each: len(each.shown) == 1)
        rig.feed.offer(0, bytes(Number(value=1).SerializeToString()), 999)
        await slow.until(lambda each: bool(each.shown) and each.shown[-1].log_ns == 999)
        assert len(slow.shown) < 200, "the newest took the place of the oldest"


async def test_when_the_service_ends_its_channels_go(tmp_path: Path) -> None:
    async with AsyncExitStack() as stack:
        rig = await stack.enter_async_context(fed(tmp_path))
        viewer = await stack.enter_async_context(watching(rig.port))
        await viewer.until(lambda each: len(each.channels) == 3)
        await asyncio.to_thread(rig.feed.close)
        await viewer.until(lambda each: not each.channels)


@pytest.mark.parametrize(
    "said",
    [
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 999}]}',
        '{"op": "subscribe"}',
        '{"op": "unsubscribe", "subscriptionIds": [-1]}',
        '{"op": "advertise", "channels": []}',
        "no JSON",
        "[]",
        b"\x01\x00\x00\x00\x00data",
    ],
)
async def test_what_is_no_subscription_is_told_and_harms_nothing(tmp_path: Path, said: str | bytes) -> None:
    async with fed(tmp_path) as rig, watching(rig.port) as viewer:
        await viewer.connection.send(said)
        await viewer.until(lambda each: len(each.statuses) == 1)
        await viewer.until(lambda each: len(each.channels) == 3)


async def test_a_viewer_on_the_desk_is_served(tmp_path: Path) -> None:
    """To its own engine it is a page in a file. One that a browser opened says null."""
    async with fed(tmp_path, access_of(LiveSettings(), "live")) as rig:
        async with watching(rig.port, origin="file://") as viewer:
            assert viewer.info
        with pytest.raises(InvalidStatus):
            async with watching(rig.port, origin="null"):
                pass


async def test_pages_of_others_are_refused(tmp_path: Path) -> None:
    access = Access(allowed_origins=frozenset({"https://viewer.example"}))
    async with fed(tmp_path, access) as rig:
        for origin in ("https://evil.example", "null", "http://localhost:8080"):
            with pytest.raises(InvalidStatus) as refused:
                async with watching(rig.port, origin=origin):
                    pass
            assert refused.value.response.status_code == 403
            assert json.loads(refused.value.response.body)["cause"] == "refused.foreign_origin"
        with pytest.raises(InvalidStatus) as refused:
            async with watching(rig.port, additional_headers={"Sec-Fetch-Site": "cross-site"}):
                pass
        assert refused.value.response.status_code == 403
        async with watching(rig.port, origin="https://viewer.example") as viewer:
            assert viewer.info


async def test_with_a_token_nobody_looks_without(tmp_path: Path) -> None:
    access = Access(tokens={Role.LOOK: bytes(range(32))})
    given = {"Authorization": f"Bearer {bytes(range(32)).hex()}"}
    async with (
        fed(tmp_path, access) as rig,
        httpx.AsyncClient(base_url=f"http://127.0.0.1:{rig.port}") as asked,
    ):
        for headers in ({}, {"Authorization": f"Bearer {bytes(32).hex()}"}):
            with pytest.raises(InvalidStatus) as refused:
                async with watching(rig.port, additional_headers=headers):
                    pass
            assert refused.value.response.status_code == 401
            assert (await asked.get("/metrics", headers=headers)).status_code == 401
        async with watching(rig.port, additional_headers=given) as viewer:
            assert viewer.info
        assert (await asked.get("/metrics", headers=given)).text == "longreach_tested 1\n"


async def test_figures_are_asked_of_the_service(tmp_path: Path) -> None:
    async with fed(tmp_path) as rig, httpx.AsyncClient(base_url=f"http://127.0.0.1:{rig.port}") as asked:
        async with asyncio.timeout(WITHIN_S):
            while not (told := await asked.get("/metrics")).text:  # noqa: ASYNC110  it introduces itself
                await asyncio.sleep(0.01)
        assert told.headers["content-type"].startswith("text/plain; version=0.0.4")
        assert told.text == "longreach_tested 1\n"
        assert (await asked.get("/metrics", headers={"Host": "evil.example"})).status_code == 421
        assert (await asked.post("/metrics")).status_code == 405
        assert (await asked.get("/else")).status_code == 404


async def test_only_so_many_viewers_look(tmp_path: Path) -> None:
    async with fed(tmp_path) as rig, AsyncExitStack() as viewers:
        for _ in range(VIEWERS_MAX):
            await viewers.enter_async_context(watching(rig.port))
        with pytest.raises(InvalidStatus) as refused:
            await viewers.enter_async_context(watching(rig.port))
        assert refused.value.response.status_code == 503


@pytest.mark.parametrize(
    ("feeds", "setting", "cause"),
    [
        (None, "live.port=0", "configuration.missing"),
        ("absent/feeds", "live.port=0", "configuration.bad_address"),
        ("feeds", "live.prt=0", "configuration.unknown_key"),
        ("feeds", "lve.port=0", "configuration.unknown_key"),
        ("feeds", "live.host=0.0.0.0", "configuration.token_wanted"),
    ],
)
def test_the_process_refuses_what_it_cannot_serve(
    tmp_path: Path, feeds: str | None, setting: str, cause: str
) -> None:
    command = [sys.executable, "-m", "foundation.live", setting]
    environment = os.environ | {wire.FEEDS_VARIABLE: str(tmp_path / feeds) if feeds else ""}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith(f"live: {cause}: ")


async def test_a_feeder_that_says_nonsense_is_cut_off() -> None:
    log = EventLog("test", io.StringIO())
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    with ours:
        reader, writer = await asyncio.open_connection(sock=theirs)
        ours.sendall(struct.pack("<BIQI", wire.MESSAGE, 0, 0, wire.MOST + 1))
        await asyncio.wait_for(LiveServer(ANYBODY_HERE, log, "t").fed(reader, writer), WITHIN_S)
    log.close()
