"""A guided session on the simulated hydraulic arm: it moves, swings, settles; its camera takes pictures."""

from pathlib import Path

import numpy as np
import pytest

from protocol.errors import RequestRefused
from protocol.reference_messages import ReferencePose
from tests.support.guided_rig import GuidedRig, quiet, start
from tests.vision_pc.hand_eye.still_rig import still_settings
from vision_pc.core import se3
from vision_pc.core.hand_eye.guided import nominal_model


def test_two_samples_on_the_hydraulic_arm_and_none_while_it_moves(tmp_path: Path) -> None:
    quick = {"vision": {"hand_eye": {"frames": 1, "minimum_frames": 1}, "motion": {"settle_timeout_s": 0.5}}}
    rig = GuidedRig(still_settings(**quick), 1, tmp_path)
    check = start(rig, "monday", 1)
    assert check["verdict"].endswith("0/17: ready")
    X_BT = rig.run(rig.arm.view()).X_BT
    away = se3.transform(X_BT[:3, :3], X_BT[:3, 3] + [-0.08, 0.0, 0.05])
    rig.run(rig.link.request(ReferencePose(0, se3.to_pose(away), 2.0)))
    with pytest.raises(RequestRefused) as refused:
        rig.run(rig.guided.sample(quiet))
    assert refused.value.cause == "refused.moving"
    assert [s.name for s in rig.guided.session.samples] == ["1"]
    outside = se3.transform(X_BT[:3, :3], X_BT[:3, 3] + [3.0, 0.0, 0.0])
    with pytest.raises(RequestRefused) as refused:
        rig.run(rig.arm.move_to(outside))
    assert refused.value.cause == "refused.too_far"

    done = rig.run(rig.guided.next_pose(quiet))
    rig.run(rig.guided.sample(quiet))
    assert len(rig.guided.session.samples) == 2
    seen_at = np.mean(rig.guided.session.samples[-1].corners_left, axis=0)
    assert np.abs(seen_at - done["pixel"]).max() < 200.0  # the mount is only measured by tape yet
    assert rig.guided.session.samples[-1].moved_mrad < 1.0
    for taken in rig.guided.session.samples:  # the joints are those of the pose
        way, turn = nominal_model.mismatch(rig.guided.session.links, taken.q[None], taken.X_BT[None])
        assert way[0] < 0.002
        assert turn[0] < 0.001
