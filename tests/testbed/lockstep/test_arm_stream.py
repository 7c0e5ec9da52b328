"""The arm's stream of references in lockstep: followed to its end, or raised with the arm stopped."""

import numpy as np
import pytest

from protocol.errors import LongreachError, RequestRefused
from protocol.faults import CommandCode, FaultCode, GroupState
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.world import World
from testbed.scenarios.scenario import chosen_overrides, load_settings
from tests.support.paths import CONFIGS
from vision_pc.application.link_arm import LinkArm
from vision_pc.core.ports import ReferenceStream
from vision_pc.core.se3 import Array

PERIOD_NS = 33_000_000


class Streamer:
    """An enabled arm in lockstep, and one way of streaming to it."""

    def __init__(self) -> None:
        settings = load_settings(CONFIGS, chosen_overrides(CONFIGS, None, 1, []))
        self.world = World(settings, 1, RunLog())
        self.link = self.world.link
        self.arm = LinkArm(self.link, settings.vision.motion)
        self.world.connect()
        run(self.link.command(CommandCode.ENABLE))
        run(self.link.next_state())
        self.home = run(self.arm.view()).X_BT

    def ahead(self, y: float) -> Array:
        X = self.home.copy()
        X[1, 3] += y
        return X

    async def send(self, stream: ReferenceStream, X: Array, seconds: float) -> None:
        """``X`` every 33 ms of simulated time."""
        until_ns = self.world.time_ns + round(seconds * 1e9)
        next_ns = self.world.time_ns
        while self.world.time_ns < until_ns:
            if self.world.time_ns >= next_ns:
                await stream.send(X)
                next_ns += PERIOD_NS
            self.world.clock.advance()

    def at_rest(self) -> bool:
        """Whether the arm comes to rest within two seconds."""
        for _ in range(400):
            self.world.clock.advance()
        before, now = self.world.states[-20], self.world.states[-1]
        return bool(np.allclose(before.X_BT_cmd.p_m, now.X_BT_cmd.p_m, atol=2e-3))


@pytest.fixture
def streamer() -> Streamer:
    return Streamer()


def test_leaving_the_stream_settles_at_the_newest_reference(streamer: Streamer) -> None:
    async def program() -> None:
        async with streamer.arm.streaming() as stream:
            await streamer.send(stream, streamer.ahead(0.05), 1.0)
            view = await stream.view()
            assert view.group_state is GroupState.MOVING
            await streamer.send(stream, streamer.ahead(0.08), 0.5)

    run(program())
    view = run(streamer.arm.view())
    assert view.motion_done
    assert view.X_BT[:3, 3] == pytest.approx(streamer.ahead(0.08)[:3, 3], abs=2e-3)


def test_a_refused_reference_is_raised_and_stops_the_arm(streamer: Streamer) -> None:
    async def program() -> None:
        async with streamer.arm.streaming() as stream:
            await streamer.send(stream, streamer.ahead(0.1), 1.0)
            await streamer.send(stream, streamer.ahead(2.0), 0.2)

    with pytest.raises(RequestRefused) as caught:
        run(program())
    assert caught.value.cause == "refused.too_far"
    assert "limit 0.5" in str(caught.value)
    assert streamer.at_rest()
    assert run(streamer.arm.view()).group_state is GroupState.STANDBY


def test_a_program_that_pauses_too_long_is_told_so(streamer: Streamer) -> None:
    async def program() -> None:
        async with streamer.arm.streaming() as stream:
            await streamer.send(stream, streamer.ahead(0.1), 1.0)
            for _ in range(40):
                streamer.world.clock.advance()
            await stream.send(streamer.ahead(0.1))

    with pytest.raises(RequestRefused) as caught:
        run(program())
    assert caught.value.cause == "refused.fault_reference_stale"
    assert run(streamer.arm.view()).fault is FaultCode.REFERENCE_STALE
    assert streamer.at_rest()


def test_an_error_inside_stops_the_arm_and_is_passed_on(streamer: Streamer) -> None:
    async def program() -> None:
        async with streamer.arm.streaming() as stream:
            await streamer.send(stream, streamer.ahead(0.2), 1.0)
            raise ValueError("the program broke")

    with pytest.raises(ValueError, match="the program broke"):
        run(program())
    assert streamer.at_rest()
    assert run(streamer.arm.view()).group_state is GroupState.STANDBY


def test_an_old_measurement_is_refused(streamer: Streamer) -> None:
    async def program() -> None:
        async with streamer.arm.streaming() as stream:
            for _ in range(20):
                await stream.send(streamer.ahead(0.1), measured_ns=streamer.world.vision_ns - 300_000_000)
                streamer.world.clock.advance()

    with pytest.raises(RequestRefused) as caught:
        run(program())
    assert caught.value.cause == "refused.stale"


def test_a_stream_needs_an_enabled_arm_and_a_link(streamer: Streamer) -> None:
    async def enter() -> None:
        async with streamer.arm.streaming():
            raise AssertionError("it was opened")

    def cause() -> str:
        with pytest.raises(LongreachError) as caught:
            run(enter())
        return caught.value.cause

    run(streamer.link.command(CommandCode.DISABLE))
    assert cause() == "refused.disabled"
    streamer.world.link.disconnect()
    streamer.world.clock.advance()
    assert cause() == "link.not_connected"
