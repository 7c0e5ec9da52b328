"""The arm's stream over a real socket, against the controller's own session and scan in a thread."""

import asyncio
import io
from collections.abc import AsyncIterator

import numpy as np
import pytest

from foundation.event_log import EventLog
from protocol.errors import RequestRefused
from protocol.faults import CommandCode, GroupState
from protocol.reference_messages import ANY_ARM
from tests.conformance.controllers import ControllerUnderTest
from tests.vision_pc.shell.loopback_controller import until
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.config.vision import LinkSettings, MotionSettings
from vision_pc.core.se3 import Array
from vision_pc.shell.camera_eyes import MonotonicClock
from vision_pc.shell.link.udp_endpoint import UdpEndpoint

pytestmark = pytest.mark.realtime


@pytest.fixture
async def link() -> AsyncIterator[ReferenceLink]:
    with ControllerUnderTest() as controller:
        settings = LinkSettings(port=controller.port, state_period_ms=10)
        endpoint = UdpEndpoint(settings, ANY_ARM, EventLog("vision_pc", io.StringIO()), MonotonicClock())
        link = endpoint.link
        await endpoint.start()
        await until(lambda: link.connected and link.clock_offset is not None)
        await link.command(CommandCode.ENABLE)
        await link.next_state()
        yield link
        await endpoint.close()


def raised(X_BT: Array, z: float) -> Array:
    X = X_BT.copy()
    X[2, 3] += z
    return X


@pytest.mark.slow("a stream in real time")
async def test_a_stream_is_followed_to_its_newest_reference(link: ReferenceLink) -> None:
    arm = LinkArm(link, MotionSettings())
    home = (await arm.view()).X_BT
    goal = raised(home, 0.02)
    async with arm.streaming() as stream:
        for _ in range(60):
            await stream.send(goal)
            await asyncio.sleep(0.01)
        assert (await stream.view()).group_state is GroupState.MOVING
    view = await arm.view()
    assert view.motion_done
    assert view.settled
    assert view.X_BT[:3, 3] == pytest.approx(goal[:3, 3], abs=2e-3)


async def test_a_refusal_comes_back_by_name_and_stops_the_arm(link: ReferenceLink) -> None:
    arm = LinkArm(link, MotionSettings())
    home = (await arm.view()).X_BT

    async def jumping() -> None:
        async with arm.streaming() as stream:
            for k in range(100):
                await stream.send(raised(home, 0.001 * k if k < 20 else 5.0))
                await asyncio.sleep(0.01)

    with pytest.raises(RequestRefused) as caught:
        await jumping()
    assert caught.value.cause == "refused.too_far"
    await until(lambda: link.state.group_state is GroupState.STANDBY)
    rest = link.state.X_BT_cmd.p_m
    await link.next_state()
    assert np.allclose(link.state.X_BT_cmd.p_m, rest)
