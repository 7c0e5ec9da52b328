"""The console's streams: made once for all who follow, only while somebody does; the slow skip."""

import asyncio
import contextlib
import json
from typing import Any

import cv2
import httpx
import numpy as np
import pytest

from foundation.rest.guard import Role
from protocol.errors import LinkLost, RequestRefused
from protocol.faults import FaultCode
from tests.vision_pc.shell.rest_server import served_bench
from vision_pc.application.console.advice import advice
from vision_pc.core.types import StereoPair
from vision_pc.shell.rest.console.routes import HEADER, Broadcast, message

LOOK, OPERATE = bytes(range(32)), bytes(range(1, 33))
WITHIN_S = 30.0


class Counted:
    """Makes numbers, and fails when told to."""

    def __init__(self) -> None:
        self.made = 0
        self.failures = 0

    async def __call__(self) -> bytes:
        if self.failures:
            self.failures -= 1
            raise LinkLost("link.camera_silent", "none")
        self.made += 1
        return str(self.made).encode()


async def test_nothing_is_made_while_nobody_follows() -> None:
    make = Counted()
    broadcast = Broadcast(make, 0.001, 4, "numbers")
    await asyncio.sleep(0.02)
    assert make.made == 0
    follower = broadcast.follow()
    assert await anext(follower) == b"1"
    assert broadcast.followers == 1
    await follower.aclose()
    assert broadcast.followers == 0
    await asyncio.sleep(0.01)
    made = make.made
    await asyncio.sleep(0.02)
    assert make.made == made


async def test_all_followers_get_the_same_and_a_slow_one_skips() -> None:
    make = Counted()
    broadcast = Broadcast(make, 0.001, 4, "numbers")
    slow, quick = broadcast.follow(), broadcast.follow()
    assert await anext(slow) == b"1"
    seen = [int(await anext(quick)) for _ in range(5)]
    assert seen == sorted(set(seen))
    assert int(await anext(slow)) >= seen[-1] - 1  # what it missed is not queued
    await slow.aclose()
    await quick.aclose()


async def test_it_goes_on_after_trouble_and_refuses_one_too_many() -> None:
    make = Counted()
    make.failures = 1
    broadcast = Broadcast(make, 0.001, 1, "numbers")
    follower = broadcast.follow()
    assert await anext(follower) == b"1"
    with pytest.raises(RequestRefused) as refused:
        broadcast.refuse_more()
    assert refused.value.cause == "refused.too_many_followers"
    await follower.aclose()
    broadcast.refuse_more()


def test_a_message_holds_both_eyes() -> None:
    left = np.tile(np.arange(128, dtype=np.uint8), (72, 1))
    data = message(StereoPair(left, 255 - left, 123_456_789, 42))
    length, capture_ns, encoded_ns, frame, left_bytes = HEADER.unpack_from(data)
    assert (length + 4, frame) == (len(data), 42)
    assert encoded_ns > capture_ns == pytest.approx(123_456_789, abs=5e6)
    eyes = [
        cv2.imdecode(np.frombuffer(part, np.uint8), cv2.IMREAD_GRAYSCALE)
        for part in (data[HEADER.size : HEADER.size + left_bytes], data[HEADER.size + left_bytes :])
    ]
    assert [eye.shape for eye in eyes] == [(72, 128), (36, 64)]  # type: ignore[union-attr]
    assert np.abs(np.asarray(eyes[0], float) - left).max() < 12


def snapshots(response: httpx.Response) -> Any:
    for line in response.iter_lines():
        if line.startswith("data: "):
            yield json.loads(line.removeprefix("data: "))


@pytest.mark.realtime
def test_the_stream_tells_of_state_alarms_and_operations() -> None:
    with served_bench() as (url, bench), httpx.stream("GET", f"{url}/events", timeout=WITHIN_S) as stream:
        every = snapshots(stream)
        first = next(every)
        assert stream.headers["content-type"].startswith("text/event-stream")
        assert first["state"]["group_state"] == "standby"
        assert len(first["skeleton"]) == 8
        assert first["alarms"] == []
        assert first["home"]["p_m"] == pytest.approx(first["state"]["X_BT"]["p_m"])
        bench.controller.break_down(FaultCode.FOLLOWING_ERROR)
        broken = next(each for each in every if each["alarms"])
        assert broken["alarms"][0]["cause"] == "fault.following_error"
        assert "blocks the joint" in broken["alarms"][0]["advice"]
        assert httpx.post(f"{url}/operations/move", json={"offset_base_m": [0, 0, 0.1]}).status_code == 409
        httpx.post(f"{url}/reset")
        ended = next(each for each in every if each["alarms"][0]["ended_at"] is not None)
        assert ended["state"]["group_state"] == "disabled"
        assert httpx.post(f"{url}/operations/look").status_code == 202
        looked = next(each for each in every if each["operations"] and each["look"])
        assert looked["operations"][-1]["title"] == "Look at tool and object with the arm at rest"
        httpx.post(f"{url}/enable")
        bench.controller.speed = 0.0001
        assert httpx.post(f"{url}/operations/move", json={"offset_base_m": [0, 0, 0.1]}).status_code == 202
        next(each for each in every if each["state"]["group_state"] == "moving")
        bench.controller.break_down(FaultCode.OVERSPEED)
        failed = next(each for each in every if len(each["alarms"]) > 2)["alarms"]
        assert any(alarm["detail"].startswith("Move the tool point to point: ") for alarm in failed)


@pytest.mark.realtime
def test_pictures_come_while_they_are_watched() -> None:
    with served_bench() as (url, bench):
        with httpx.stream("GET", f"{url}/camera/live", timeout=WITHIN_S) as stream:
            received, frames = bytearray(), []
            for piece in stream.iter_bytes():
                received += piece
                while len(received) >= 4 and len(received) >= 4 + HEADER.unpack_from(received)[0]:
                    length, _, _, frame, _ = HEADER.unpack_from(received)
                    frames.append(frame)
                    del received[: 4 + length]
                if len(frames) >= 3:
                    break
        assert frames == sorted(set(frames))
        assert bench.eyes.pictures >= 3


@pytest.mark.realtime
def test_the_page_is_anybodys_and_nothing_else_is() -> None:
    with served_bench(tokens={Role.LOOK: LOOK, Role.OPERATE: OPERATE}) as (url, _):
        refused = httpx.get(f"{url}/state").json()
        assert (refused["cause"], refused["advice"]) == ("refused.no_token", advice("refused.no_token"))
        page = httpx.get(url)
        assert page.status_code == 200
        assert "default-src 'none'" in page.headers["content-security-policy"]
        assert httpx.get(f"{url}/console/app.js").status_code == 200
        for path in ("events", "camera/live", "state", "access", "docs", "console/../state"):
            answer = httpx.get(f"{url}/{path}")
            assert (answer.status_code, answer.json()["cause"]) == (401, "refused.no_token"), path
        for token, role in ((LOOK, "look"), (OPERATE, "operate")):
            bearer = {"Authorization": f"Bearer {token.hex()}"}
            told = httpx.get(f"{url}/access", headers=bearer).json()
            assert told == {"role": role, "token_wanted": True, "emulator_face": None}
    with served_bench() as (url, _), contextlib.closing(httpx.Client()) as client:
        told = client.get(f"{url}/access").json()
        assert told == {"role": "operate", "token_wanted": False, "emulator_face": None}
        assert "connect-src 'self';" in client.get(url).headers["content-security-policy"]


@pytest.mark.realtime
def test_the_page_may_ask_the_emulator_that_is_named_and_nobody_else() -> None:
    face = "http://127.0.0.1:8010"
    with served_bench(emulator_face=face) as (url, _), contextlib.closing(httpx.Client()) as client:
        assert client.get(f"{url}/access").json()["emulator_face"] == face
        for path in ("", "/console/app.js"):
            policy = client.get(f"{url}{path}").headers["content-security-policy"]
            assert f"connect-src 'self' {face};" in policy
