"""The whole loop in lockstep over an authenticated link: the same motion, whatever a forger adds to it."""

from pathlib import Path

import numpy as np
import pytest

from conformance.wire import resealed
from protocol.datagram import decode
from protocol.faults import CommandCode, GroupState, Reason
from protocol.reference_messages import Command, ReferencePose
from testbed.lockstep.clock import RunLog
from testbed.lockstep.world import World
from testbed.scenarios.scenario import chosen_overrides, load_settings
from tests.support.paths import CONFIGS

MS = 1_000_000


def world_of(*assignments: str) -> World:
    settings = load_settings(CONFIGS, chosen_overrides(CONFIGS, "standard", 1, list(assignments)))
    return World(settings, 1, RunLog())


@pytest.fixture
def keyed(tmp_path: Path) -> tuple[str, str]:
    """The assignments that give both sides the same key."""
    path = tmp_path / "link.key"
    path.write_text("c3" * 32)
    path.chmod(0o600)
    return (
        f"controller.reference_link.link_key.file={path}",
        f"vision.link.link_key.file={path}",
    )


def until(world: World, time_ns: int) -> World:
    while world.time_ns < time_ns:
        world.clock.advance()
    return world


def driven(world: World) -> World:
    """``world`` after enabling at 200 ms and a reference at 300 ms; half a second later."""
    until(world, 200 * MS).link.submit(Command(0, CommandCode.ENABLE))
    here = until(world, 300 * MS).states[-1].X_BT
    x, y, z = here.p_m
    world.link.submit(ReferencePose(0, here._replace(p_m=(x, y + 0.2, z)), 0.0))
    return until(world, 800 * MS)


def test_an_authenticated_loop_moves_as_the_plain_one_does(keyed: tuple[str, str]) -> None:
    signed, plain = driven(world_of(*keyed)), driven(world_of())
    assert signed.states[-1].group_state is plain.states[-1].group_state is GroupState.MOVING
    assert np.array_equal(signed.plant.truth().X_WT, plain.plant.truth().X_WT)
    assert signed.link.statistics.dropped == 0
    assert signed.states[-1].references_dropped == 0


def test_replays_and_forgeries_on_the_wire_change_nothing_but_the_counters(keyed: tuple[str, str]) -> None:
    world, clean = world_of(*keyed), driven(world_of(*keyed))
    heard: list[bytes] = []

    def forger(datagrams: list[bytes]) -> list[bytes]:
        """Every datagram, a recorded one again, and each with a bit of its content changed."""
        heard.extend(datagrams)
        forged = [resealed(data[:48] + bytes([data[48] ^ 1]) + data[49:]) for data in datagrams]
        return [*forged, *datagrams, *datagrams, *heard[:1], *heard[-20:-18]]

    world.to_controller = forger
    driven(world)
    assert world.states[-1].group_state is GroupState.MOVING
    assert np.array_equal(world.plant.truth().X_WT, clean.plant.truth().X_WT)
    answers = [event for event in world.log.events if event["event"] == "acknowledgement"]
    assert {event["reason"] for event in answers} == {Reason.ACCEPTED.name}
    assert world.states[-1].references_dropped > 2 * len(heard) - 50
    assert world.states[-1].references_lost == 0
    assert all(decode(data).header.flags & 0x100 for data in heard)
