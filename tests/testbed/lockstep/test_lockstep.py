"""The lockstep rig: bit-identical reruns, and every refusal with its cause while the arm holds still."""

from typing import Any

import numpy as np
import pytest

from protocol.errors import LinkLost, LongreachError, RequestRefused
from protocol.faults import GroupState
from protocol.pose import Pose
from protocol.reference_messages import ReferencePose
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.rig import LockstepRig
from testbed.reporting.console import bars
from testbed.scenarios.scenario import chosen_overrides, load_settings
from tests.support.paths import CONFIGS
from vision_pc.application.link_arm import LinkArm
from vision_pc.core.se3 import from_pose

pytestmark = pytest.mark.slow("whole worlds in lockstep")

LITTLE_M = 1e-3  # what leakage past shut valves, and the servo against it, move the tool within a second


def rig_of(seed: int, *assignments: str) -> LockstepRig:
    settings = load_settings(CONFIGS, chosen_overrides(CONFIGS, "standard", seed, list(assignments)))
    return LockstepRig(settings, seed, RunLog())


def operate(rig: LockstepRig, kind: str, **body: object) -> Any:
    with bars(quiet=True) as shown, shown.step(kind) as bar:
        return rig.operate(kind, dict(body), bar)


def true_tool(rig: LockstepRig) -> np.ndarray:
    return np.array(rig.world.plant.truth().X_WT[:3, 3])


def looked_and_moved(seed: int) -> LockstepRig:
    rig = rig_of(seed)
    rig.command("enable")
    operate(rig, "look", frames=2)
    operate(rig, "move", offset_base_m=[0.0, 0.02, 0.0])
    return rig


def test_the_same_seed_gives_the_same_event_log_and_two_seeds_differ() -> None:
    first, again, other = looked_and_moved(3), looked_and_moved(3), looked_and_moved(4)
    assert first.world.log.digest() == again.world.log.digest()
    assert np.array_equal(true_tool(first), true_tool(again))
    assert first.world.log.digest() != other.world.log.digest()
    kinds = [event["event"] for event in first.world.log.events]
    assert {"request", "acknowledgement", "look", "state", "operation", "operation_ended"} <= set(kinds)


def test_a_move_while_disabled_is_refused_and_nothing_moves() -> None:
    rig = rig_of(1)
    before = true_tool(rig)
    with pytest.raises(RequestRefused) as caught:
        operate(rig, "move", offset_base_m=[0.0, 0.05, 0.0])
    assert caught.value.cause == "refused.disabled"
    for _ in range(200):
        rig.world.clock.advance()
    assert np.linalg.norm(true_tool(rig) - before) < LITTLE_M


def test_the_controller_itself_refuses_to_move_while_disabled() -> None:
    rig = rig_of(1)
    with pytest.raises(RequestRefused) as caught:
        run(rig.link.request(ReferencePose(0, rig.link.state.X_BT, 0.0)))
    assert caught.value.cause == "refused.disabled"


@pytest.mark.parametrize(
    ("p_m", "q_scale", "cause"),
    [
        ((float("nan"), 0.0, 1.0), 1.0, "refused.not_finite"),
        ((float("inf"), 0.0, 1.0), 1.0, "refused.not_finite"),
        ((3.9, 0.0, 1.0), 1.1, "refused.not_unit_quaternion"),
        ((5.6, 0.0, 1.0), 1.0, "refused.outside_workspace"),
        ((3.9, 0.0, -2.0), 1.0, "refused.outside_workspace"),
        ((5.15, 1.2, 2.4), 1.0, "refused."),
    ],
)
def test_a_reference_that_cannot_be_is_refused_whole(
    p_m: tuple[float, float, float], q_scale: float, cause: str
) -> None:
    rig = rig_of(1)
    rig.command("enable")
    for _ in range(200):
        rig.world.clock.advance()
    before = true_tool(rig)
    w, x, y, z = (q_scale * value for value in rig.link.state.X_BT.q_wxyz)
    with pytest.raises(RequestRefused) as caught:
        run(rig.link.request(ReferencePose(0, Pose(p_m, (w, x, y, z)), 0.0)))
    assert caught.value.cause.startswith(cause)
    assert "\n" not in str(caught.value)
    for _ in range(200):
        rig.world.clock.advance()
    assert rig.link.state.group_state is GroupState.STANDBY
    assert np.linalg.norm(true_tool(rig) - before) < LITTLE_M


def test_looking_while_moving_is_refused() -> None:
    rig = rig_of(1)
    rig.command("enable")
    here = rig.link.state.X_BT
    run(rig.link.request(ReferencePose(0, here._replace(p_m=(here.p_m[0], 0.2, here.p_m[2])), 0.0)))
    run(rig.link.next_state())
    with pytest.raises(RequestRefused) as caught:
        operate(rig, "look")
    assert caught.value.cause == "refused.moving"


def test_a_marker_out_of_view_fails_the_look_and_is_never_a_zero() -> None:
    rig = rig_of(1, "scene.object_of_interest.position_m=[4.59, 3.5, 1.09]")
    rig.command("enable")
    before = true_tool(rig)
    with pytest.raises(LongreachError) as caught:
        operate(rig, "orientation-adjustment")
    assert caught.value.cause == "measurement.object_not_seen"
    with pytest.raises(RequestRefused) as none_yet:
        rig.latest_look()
    assert none_yet.value.cause == "refused.no_look_yet"
    assert np.linalg.norm(true_tool(rig) - before) < LITTLE_M


def test_a_silent_controller_is_told_as_such() -> None:
    rig = rig_of(1)
    rig.world.to_vision = lambda datagrams: []

    async def wait() -> None:
        while True:
            await rig.link.next_state()

    with pytest.raises(LinkLost) as caught:
        run(wait())
    assert caught.value.cause in ("link.link_timeout", "link.silent")


def test_repeated_and_reordered_datagrams_have_one_effect_in_order() -> None:
    rig = rig_of(1)
    rig.command("enable")
    held: list[bytes] = []

    def troubled(datagrams: list[bytes]) -> list[bytes]:
        """Everything twice, and once more a cycle later, after what was sent since."""
        late = [*datagrams, *datagrams, *held]
        held[:] = datagrams
        return late

    rig.world.to_controller = troubled
    first = rig.link.state.X_BT
    result = operate(rig, "move", offset_base_m=[0.0, 0.04, 0.0])
    answers = [
        e for e in rig.world.log.events if e["event"] == "controller" and "Reference" in e["what"]["name"]
    ]
    assert len(answers) == 1, "a request that comes three times is executed once"
    assert rig.link.state.references_dropped > 0
    assert rig.link.state.motion_done
    assert result.miss_m < 4e-3
    assert rig.link.state.X_BT.p_m[1] - first.p_m[1] == pytest.approx(0.04, abs=0.004)


def test_a_motion_that_nobody_attends_to_is_ended() -> None:
    rig = rig_of(1)
    rig.command("enable")
    here = rig.link.state.X_BT
    goal = here._replace(p_m=(here.p_m[0], here.p_m[1] + 0.3, here.p_m[2]))
    run(rig.link.request(ReferencePose(0, goal, 6.0)))
    rig.world.to_controller = lambda datagrams: []
    for _ in range(600):
        rig.world.clock.advance()
    faults = [e["what"]["cause"] for e in rig.world.log.events if e["event"] == "controller"]
    assert "REFERENCE_LINK_LOST" in faults
    before = true_tool(rig)
    for _ in range(200):
        rig.world.clock.advance()
    assert np.linalg.norm(true_tool(rig) - before) < LITTLE_M
    assert before[1] < goal.p_m[1] - 0.1, "it must have stopped on its way"


def test_the_arm_arrives_where_the_controller_was_told_to_go() -> None:
    rig = rig_of(2)
    rig.command("enable")
    arm = LinkArm(rig.link, rig.world.settings.vision.motion)
    target = from_pose(rig.link.state.X_BT)
    target[:3, 3] += [0.05, 0.03, -0.04]
    view = run(arm.move_to(target))
    assert np.linalg.norm(view.X_BT[:3, 3] - target[:3, 3]) < 0.004
    assert view.settled
