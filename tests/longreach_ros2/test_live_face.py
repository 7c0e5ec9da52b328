"""The live face as the watching node reads it, and the command line where there is no ROS."""

import asyncio
import base64
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from websockets.asyncio.server import ServerConnection, serve
from websockets.typing import Subprotocol

from foundation.live import wire
from foundation.recording.messages import format_of
from longreach_ros2.__main__ import main
from longreach_ros2.live_client import LiveMessage, live_messages
from protocol.errors import ConfigurationError, LinkLost

FORMAT = format_of(FrameTransforms)
TOPICS = ("/tf_true", "/other")


@asynccontextmanager
async def face(log_ns: int) -> AsyncIterator[str]:
    """A server that shows both topics, and one message of what is asked for, logged at ``log_ns``."""

    async def show(connection: ServerConnection) -> None:
        shape = {
            "encoding": FORMAT.message_encoding,
            "schemaName": FORMAT.schema,
            "schemaEncoding": FORMAT.schema_encoding,
            "schema": base64.b64encode(FORMAT.data).decode(),
        }
        channels = [{"id": number, "topic": topic} | shape for number, topic in enumerate(TOPICS, 7)]
        await connection.send(wire.server_info("test", "1"))
        await connection.send(wire.advertise(channels))
        asked = wire.subscriptions(await connection.recv())
        said = FrameTransforms()
        said.transforms.add(parent_frame_id="world", child_frame_id="true/tool")
        for number in asked.added:
            await connection.send(wire.message_data(number, log_ns, said.SerializeToString()))

    async with serve(show, "127.0.0.1", 0, subprotocols=[Subprotocol("foxglove.sdk.v1")]) as server:
        yield f"ws://127.0.0.1:{next(iter(server.sockets)).getsockname()[1]}"


async def shown(url: str, found: list[LiveMessage]) -> None:
    """Fill ``found`` with what comes until the face ends, and raise as ``live_messages`` does then."""
    async with asyncio.timeout(10.0):
        async for message in live_messages(url, {"/tf_true"}):
            found.append(message)  # noqa: PERF401 -- what came before an error counts too


async def test_wanted_topics_are_asked_for_and_their_messages_decoded() -> None:
    now_ns = time.monotonic_ns()
    found: list[LiveMessage] = []
    async with face(now_ns) as url:
        with pytest.raises(LinkLost, match="it has ended"):
            await shown(url, found)
    (message,) = found
    assert (message.topic, message.log_ns) == ("/tf_true", now_ns)
    assert message.message.transforms[0].child_frame_id == "true/tool"


@pytest.mark.parametrize("off_s", [-3600.0, 5.0])
async def test_a_face_by_the_plants_clock_is_put_on_ours(off_s: float) -> None:
    found: list[LiveMessage] = []
    async with face(max(1, time.monotonic_ns() + round(off_s * 1e9))) as url:
        with pytest.raises(LinkLost, match="it has ended"):
            await shown(url, found)
    assert abs(found[0].log_ns - time.monotonic_ns()) < 2e9


async def test_addresses_that_are_none_or_where_nobody_is_are_told() -> None:
    with pytest.raises(ConfigurationError, match="--watch 'what'"):
        await shown("what", [])
    with pytest.raises(LinkLost, match="live face at ws://127"):
        await shown("ws://127.0.0.1:9", [])


def test_without_ros_the_node_says_what_is_missing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--controller", "127.0.0.1:47000"]) == 2
    assert "configuration.no_ros: rclpy, control_msgs" in capsys.readouterr().err


def test_an_address_without_a_port_is_refused(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("longreach_ros2.__main__._check_ros", lambda: None)
    for wrong in (
        "here",
        "here:0",
        "here:99999",
        ":47000",
        "::1",
        "fe80::1:47000",
        "here:\u00b2",
        "here:4_7",
    ):
        assert main(["--controller", wrong]) == 2
        assert f"--controller {wrong!r} is not HOST:PORT" in capsys.readouterr().err
