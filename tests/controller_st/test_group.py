"""What the suite cannot see of the program: requests before a stop, and how it ramps down unattended."""

from typing import Any

import numpy as np
import pytest

from controller.core.group_states import TRANSITIONS, Stimulus
from controller_st.parts import text_parts
from protocol.axes_group import Mode
from protocol.faults import CommandCode, FaultCode, Reason
from protocol.pose import Pose
from protocol.reference_messages import Command, ReferencePose
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.world import World
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS

pytestmark = pytest.mark.slow("a world with its plant")


@pytest.fixture
def world() -> World:
    """A world whose arm is enabled."""
    made = World(load_settings(CONFIGS, {}), 1, RunLog(), text_parts)
    made.connect()
    run(made.link.command(CommandCode.ENABLE))
    for _ in range(20):
        made.step()
    return made


def raised(world: World, z: float) -> Pose:
    here = world.states[-1].X_BT_cmd
    return Pose((here.p_m[0], here.p_m[1], here.p_m[2] + z), here.q_wxyz)


def arm(world: World) -> Any:
    """The program's own variables."""
    return world.controller.program._text.arm  # type: ignore[attr-defined]


def test_a_reference_that_came_before_a_stop_is_never_judged(world: World) -> None:
    moved = world.link.submit(ReferencePose(0, raised(world, 0.1), 0.0))
    stopped = world.link.submit(Command(0, CommandCode.STOP))
    for _ in range(10):
        world.step()
    answers = {number: run(world.link.answer(number)) for number in (moved, stopped)}
    assert answers[moved].reason is Reason.OVERTAKEN
    assert (answers[moved].value, answers[moved].limit) == (float(moved), float(stopped))
    assert answers[stopped].reason is Reason.ACCEPTED
    assert arm(world).stMotion.nMotionId == 0


def test_a_motion_that_nobody_attends_ramps_down_before_the_valves_are_centred(world: World) -> None:
    run(world.link.request(ReferencePose(0, raised(world, 0.3), 0.0)))
    for _ in range(120):
        world.step()
    fast = float(np.linalg.norm(arm(world).stMotion.stDesired.v.numbers))
    assert fast > 0.1
    world.to_controller = lambda _: []
    speeds = []
    while arm(world).eMode != Mode.ERROR_HELD:
        world.step()
        if arm(world).eMode == Mode.ERROR_RAMP:
            speeds.append(float(np.linalg.norm(arm(world).stMotion.stDesired.v.numbers)))
        assert len(speeds) < 400
    assert len(speeds) > 0.3 / 0.005  # stop_min_s
    peak = speeds.index(max(speeds))  # an arm that speeds up does so for a moment more
    assert peak < 10
    assert speeds[peak:] == sorted(speeds[peak:], reverse=True)
    assert speeds[-1] < 0.1 * fast
    assert arm(world).eFault == FaultCode.REFERENCE_LINK_LOST
    assert world.controller.valve_words[1:8] == [0] * 7


def test_the_state_table_of_the_text_is_the_controllers_own(world: World) -> None:
    compiled = world.controller.program._text._program  # type: ignore[attr-defined]
    following, answers = compiled.constant("LR_NEXT"), compiled.constant("LR_ANSWER")
    steps = [TRANSITIONS[mode, each] for mode in Mode for each in Stimulus]
    assert following == [step.mode for step in steps]
    assert answers == [step.reason for step in steps]


def test_a_rerun_repeats_itself_bit_for_bit() -> None:
    digests = []
    for _ in range(2):
        again = World(load_settings(CONFIGS, {}), 3, RunLog(), text_parts)
        again.connect()
        run(again.link.command(CommandCode.ENABLE))
        run(again.link.request(ReferencePose(0, raised(again, 0.1), 0.0)))
        for _ in range(200):
            again.step()
        digests.append((again.log.digest(), again.states[-1]))
    assert digests[0] == digests[1]
