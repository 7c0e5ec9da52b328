"""The lockstep rig: bit-identical reruns, refusals with their causes, and a motion that arrives."""

from typing import Any

import numpy as np
import pytest

from protocol.errors import LongreachError, RequestRefused
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


def test_the_controller_itself_refuses_to_move_while_disabled() -> None:
    rig = rig_of(1)
    with pytest.raises(RequestRefused) as caught:
        run(rig.link.request(ReferencePose(0, rig.link.state.X_BT, 0.0)))
    assert caught.value.cause == "refused.disabled"


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


def test_the_arm_arrives_where_the_controller_was_told_to_go() -> None:
    rig = rig_of(2)
    rig.command("enable")
    arm = LinkArm(rig.link, rig.world.settings.vision.motion)
    target = from_pose(rig.link.state.X_BT)
    target[:3, 3] += [0.05, 0.03, -0.04]
    view = run(arm.move_to(target))
    assert np.linalg.norm(view.X_BT[:3, 3] - target[:3, 3]) < 0.004
    assert view.settled
