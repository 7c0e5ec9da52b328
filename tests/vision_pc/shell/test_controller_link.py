"""The reference link on a real socket, and the arm over it, against the protocol's own server session."""

import asyncio
import io
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from unittest.mock import Mock

import numpy as np
import pytest

from foundation.event_log import EventLog
from protocol.errors import LinkLost, MotionUnsettled, RequestRefused
from protocol.faults import CommandCode, GroupState, Reason
from protocol.reference_messages import ANY_ARM, Command, ReferencePose
from tests.support.paths import ROOT
from tests.vision_pc.shell.loopback_controller import LoopbackController, until
from tests.vision_pc.shell.swapped_addresses import PLACES
from tests.vision_pc.synthetic import Q_START, SyntheticRig, draw, forward
from vision_pc.application.link_arm import LinkArm
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.config.vision import LinkSettings, MotionSettings
from vision_pc.core.se3 import Array, to_pose, transform
from vision_pc.shell.camera_eyes import ProcessClock
from vision_pc.shell.link.udp_endpoint import UdpEndpoint

pytestmark = pytest.mark.realtime

X_START = forward(Q_START)


def shifted(x: float, y: float, z: float) -> Array:
    return transform(X_START[:3, :3], X_START[:3, 3] + np.array([x, y, z]))


@pytest.fixture
async def controller() -> AsyncIterator[LoopbackController]:
    controller = LoopbackController(SyntheticRig(draw(np.random.default_rng(0)), 0, rate_hz=100.0))
    await controller.start()
    yield controller
    await controller.stop()


@pytest.fixture
async def link(controller: LoopbackController) -> AsyncIterator[ReferenceLink]:
    log = EventLog("vision_pc", io.StringIO())
    endpoint = UdpEndpoint(
        LinkSettings(port=controller.port, state_period_ms=10), ANY_ARM, log, ProcessClock()
    )
    link = endpoint.link
    await endpoint.start()
    await until(lambda: link.connected)
    yield link
    await endpoint.close()


@pytest.fixture
def arm(link: ReferenceLink) -> LinkArm:
    return LinkArm(link, MotionSettings(settle_timeout_s=0.3, rest_s=0.02))


async def test_the_clock_offset_is_the_controllers(
    link: ReferenceLink, controller: LoopbackController
) -> None:
    await until(lambda: link.session.clock is not None)
    clock = link.session.clock
    assert clock is not None
    assert abs(clock.offset_ns - controller.clock_ahead_ns) <= clock.uncertainty_ns < 1_000_000_000


@pytest.mark.parametrize(
    ("prepare", "cause"),
    [([], "disabled"), ([CommandCode.EMERGENCY_STOP], "emergency_latched"),
     ([CommandCode.EMERGENCY_STOP, CommandCode.EMERGENCY_RELEASE], "error_latched")],
)  # fmt: skip
async def test_refusals_are_typed(link: ReferenceLink, prepare: list[CommandCode], cause: str) -> None:
    for code in prepare:
        await link.command(code)
    with pytest.raises(RequestRefused) as refused:
        await link.request(ReferencePose(0, to_pose(X_START), 0.0))
    assert refused.value.cause == f"refused.{cause}"
    # By which fault is told once the state that names it has been heard.
    assert str(refused.value).startswith(f"reference pose refused: {cause.replace('_', ' ')}")


async def test_a_path_passes_its_waypoints(
    link: ReferenceLink, arm: LinkArm, controller: LoopbackController
) -> None:
    await link.command(CommandCode.ENABLE)
    corners = [shifted(0.0, 0.1, 0.0), shifted(0.0, 0.1, 0.1), shifted(0.0, 0.0, 0.0)]
    view = await arm.follow(corners, dwell_s=0.05)
    assert np.allclose(view.X_BT, X_START, atol=1e-6)
    path = controller.requests[-1]
    assert len(path.waypoints) == 3
    assert path.dwell_s == 0.05


async def test_the_pose_at_a_picture_is_interpolated_on_the_controllers_clock(
    link: ReferenceLink, arm: LinkArm, controller: LoopbackController
) -> None:
    await link.command(CommandCode.ENABLE)
    true: list[tuple[int, Array]] = []
    moving = asyncio.create_task(arm.move_to(shifted(0.0, 0.3, 0.0)))
    found = []
    while not moving.done():
        true.append((time.monotonic_ns(), forward(controller.rig.q)[:3, 3]))
        await asyncio.sleep(0.02)
        found.append((await link.pose_at(true[-1][0]))[:3, 3])
    await moving
    errors = np.linalg.norm(np.array(found) - np.array([p for _, p in true]), axis=1)
    assert np.ptp(np.array(found)[:, 1]) > 0.25
    assert np.median(errors) < 0.01  # the arm steps every 10 ms at up to 1.5 m/s


async def test_a_pose_older_than_the_history_is_not_made_up(link: ReferenceLink) -> None:
    with pytest.raises(LinkLost) as lost:
        await link.pose_at(time.monotonic_ns() - 60_000_000_000)
    assert lost.value.cause == "link.state_too_old"


async def test_another_motion_overtakes(link: ReferenceLink, arm: LinkArm) -> None:
    await link.command(CommandCode.ENABLE)
    first = asyncio.create_task(arm.move_to(shifted(-0.5, 0.5, 0.5)))
    await until(lambda: link.state.group_state is GroupState.MOVING)
    await arm.move_to(shifted(0.0, 0.0, 0.05))
    with pytest.raises(RequestRefused) as refused:
        await first
    assert refused.value.cause == "refused.overtaken"


@pytest.mark.slow("a swinging arm is waited for")
async def test_an_arm_that_swings_on_is_told_and_one_that_hangs_beside_its_reference_serves(
    link: ReferenceLink, controller: LoopbackController
) -> None:
    arm = LinkArm(link, MotionSettings(settle_timeout_s=1.2, rest_s=0.45))
    await link.command(CommandCode.ENABLE)
    controller.never_settles = True
    view = await arm.move_to(shifted(0.0, 0.05, 0.0))
    assert not view.settled
    assert np.allclose(view.unrest, 0.0, atol=1e-12)
    controller.swing_rad = 0.0008  # less than it is taken for resting with
    view = await arm.move_to(shifted(0.0, 0.04, 0.0))
    assert np.allclose(view.unrest, 0.0016)
    controller.never_settles = False
    assert not (await arm.move_to(shifted(0.0, 0.03, 0.0))).unrest.any()
    controller.never_settles = True
    controller.swing_rad = 0.004
    with pytest.raises(MotionUnsettled) as failed:
        await arm.move_to(shifted(0.0, 0.0, 0.0))
    assert failed.value.cause == "motion.not_settled"


@pytest.mark.parametrize(
    ("limit_deg", "named"),
    [(104.7, " of lift"), (104.2, " of lift"), (-8.7, ""), (89.5, " of wrist1 or wrist2"), (80.0, "")],
)
def test_a_refused_joint_is_named_by_its_bound(link: ReferenceLink, limit_deg: float, named: str) -> None:
    limit = float(np.float32(np.radians(limit_deg)))
    link.ranges = {"lift": (np.radians(-9.2), np.radians(104.7))}
    link.ranges |= dict.fromkeys(("wrist1", "wrist2"), (-np.pi / 2, np.pi / 2))
    told = str(link.refused("path", Reason.JOINT_LIMIT, 2.0, limit))
    assert told == f"path refused: joint limit{named}: 114.59 deg, limit {limit_deg:.2f} deg"
    assert "lift" not in str(link.refused("path", Reason.TOO_FAST, 2.0, limit))
    below = link.refused("path", Reason.JOINT_LIMIT, np.radians(-9.0), np.radians(-8.7))
    assert str(below) == "path refused: joint limit of lift: -9.00 deg, limit -8.70 deg"


async def test_a_controller_that_is_not_there_is_named_and_found_when_it_comes() -> None:
    rig = SyntheticRig(draw(np.random.default_rng(0)), 0, rate_hz=100.0)
    first = LoopbackController(rig)
    await first.start()
    port = first.port
    await first.stop()
    settings = LinkSettings(port=port, state_period_ms=10)
    endpoint = UdpEndpoint(settings, ANY_ARM, EventLog("vision_pc", io.StringIO()), ProcessClock())
    link = endpoint.link
    await endpoint.start()
    with pytest.raises(LinkLost) as lost:
        await link.command(CommandCode.ENABLE)
    assert lost.value.cause == "link.not_connected"
    late = LoopbackController(rig)
    await late.start(port)
    await until(lambda: link.connected)
    await link.command(CommandCode.ENABLE)
    await endpoint.close()
    await late.stop()


async def test_a_controller_that_restarts_is_found_again_and_a_waiting_motion_fails(
    link: ReferenceLink, arm: LinkArm, controller: LoopbackController
) -> None:
    await link.command(CommandCode.ENABLE)
    moving = asyncio.create_task(arm.move_to(shifted(-0.5, 0.5, 0.5)))
    await until(lambda: link.state.group_state is GroupState.MOVING)
    await controller.stop(say_goodbye=False)
    with pytest.raises(LinkLost):
        await moving
    again = LoopbackController(controller.rig)
    await again.start(controller.port)
    await until(lambda: link.connected)
    assert link.state.group_state is GroupState.DISABLED  # nothing resumes by itself
    await again.stop()


async def test_commands_that_wait_end_with_the_link(
    link: ReferenceLink, controller: LoopbackController
) -> None:
    controller.datagram_received = lambda data, addr: None  # type: ignore[method-assign]
    with pytest.raises(LinkLost) as lost:
        await link.request(Command(0, CommandCode.ENABLE))
    assert lost.value.cause in {"link.link_timeout", "link.unanswered"}


def test_a_controller_that_comes_back_at_another_address_is_found() -> None:
    """In namespaces, where the name can stand for one address after another, IPv6 among them."""
    script = f"ip link set lo up && {sys.executable} -m {__package__}.swapped_addresses"
    inside = ["unshare", "-Urnm", "sh", "-c", script]
    done = subprocess.run(inside, cwd=ROOT, capture_output=True, text=True, timeout=120.0, check=False)
    if "unshare failed" in done.stderr or "RTNETLINK" in done.stderr:
        pytest.skip("no namespaces of our own here: a changed address is NOT tried")
    assert done.stdout.splitlines() == [f"found at {address}" for address in PLACES], done.stderr


async def test_an_address_without_a_way_is_tried_again(
    controller: LoopbackController, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine without IPv6 has no socket for such an address; a network may come later than we do."""
    log = EventLog("vision_pc", io.StringIO())
    endpoint = UdpEndpoint(LinkSettings(port=controller.port), ANY_ARM, log, ProcessClock())
    with monkeypatch.context() as without_a_way:
        without_a_way.setattr(socket.socket, "connect", Mock(side_effect=OSError(101, "unreachable")))
        await endpoint.start()
    await until(lambda: endpoint.link.connected)
    await endpoint.close()
