"""The excitation mode on the real plant: what ends it, who may start it, and what it finds."""

from collections.abc import Callable

import numpy as np
import pytest

from plant_emulator.core.faults.kinds import CouplerSilent
from protocol.errors import RequestRefused
from protocol.faults import CommandCode, FaultCode, GroupState
from protocol.process_image import decode_valves
from testbed.lockstep.clock import run
from testbed.lockstep.world import World
from vision_pc.application.link_arm import LinkArm

pytestmark = [pytest.mark.slow("a minute of arm time"), pytest.mark.timeout(600)]

Exciting = Callable[..., World]


def driven(world: World, joint: int) -> None:
    """Until the joint's valve is open."""
    assert world.clock.advance_until(lambda: world.states[-1].valves[joint] > 0.003, 5.0)


def assert_centred(world: World) -> None:
    """All valves are centred, now and from now on."""
    for _ in range(400):
        world.clock.advance()
        assert decode_valves(world.controller.valve_words).valves == (0.0,) * 6
    assert np.all(world.plant.truth().valves == 0.0)


@pytest.mark.parametrize(
    ("command", "then"),
    [
        (CommandCode.STOP, GroupState.STANDBY),
        (CommandCode.DISABLE, GroupState.DISABLED),
        (CommandCode.EMERGENCY_STOP, GroupState.ERROR_STOP),
    ],
)
def test_every_stop_centres_the_valves_at_once(
    exciting: Exciting, command: CommandCode, then: GroupState
) -> None:
    world = exciting()
    driven(world, 5)
    assert world.states[-1].group_state is GroupState.MOVING
    run(world.link.command(command))
    assert decode_valves(world.controller.valve_words).valves == (0.0,) * 6
    assert_centred(world)
    assert world.states[-1].group_state is then


def test_a_silent_link_centres_the_valves_and_latches_a_fault(exciting: Exciting) -> None:
    world = exciting()
    driven(world, 5)
    world.to_controller = lambda datagrams: []
    for _ in range(110):
        world.clock.advance()
    assert world.controller.program.excitation.inner.fault.code is FaultCode.REFERENCE_LINK_LOST
    assert np.all(world.plant.truth().valves == 0.0)


def test_a_silent_plant_ends_it(exciting: Exciting) -> None:
    world = exciting()
    driven(world, 5)
    world.plant.inject(CouplerSilent())
    for _ in range(100):
        world.clock.advance()
    assert world.states[-1].fault is FaultCode.PLANT_LINK_LOST
    assert decode_valves(world.controller.valve_words).valves == (0.0,) * 6


def test_references_are_refused_while_valves_are_tried_out(exciting: Exciting) -> None:
    world = exciting()
    driven(world, 5)
    arm = LinkArm(world.link, world.settings.vision.motion)
    with pytest.raises(RequestRefused) as raised:
        run(arm.move_to(run(arm.view()).X_BT))
    assert raised.value.cause == "refused.moving"


def test_a_stopped_joint_is_begun_anew_after_enable(exciting: Exciting) -> None:
    world = exciting()
    driven(world, 5)
    run(world.link.command(CommandCode.STOP))
    world.clock.advance_until(lambda: world.states[-1].group_state is GroupState.STANDBY, 2.0)
    assert_centred(world)
    run(world.link.command(CommandCode.DISABLE))
    run(world.link.command(CommandCode.ENABLE))
    driven(world, 5)
    assert world.controller.program.excitation.stroke == 0
