"""Orientation adjustment on the synthetic arm: both forms, what they assume, what they refuse."""

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.program_settings import shipped
from tests.vision_pc.synthetic import SyntheticRig, draw, silent
from vision_pc.core.calibration.orientation import adjust_orientation, orientation_error
from vision_pc.core.se3 import exp_so3, transform

SETTINGS = shipped().orientation


def rig(seed: int, **changes: object) -> SyntheticRig:
    return SyntheticRig(draw(np.random.default_rng(seed), **changes), seed)


@pytest.mark.parametrize("seed", range(10))
async def test_frame_true_form_aligns_with_any_mount(seed: int) -> None:
    arm = rig(seed)
    before = arm.true_orientation_error()
    result = await adjust_orientation(arm, arm, silent, SETTINGS)
    assert arm.true_orientation_error() < np.radians(0.25) < before
    assert np.linalg.norm(result.errors[-1]) < np.linalg.norm(result.errors[0])
    assert len(result.errors) == 2
    assert result.tool_shift_m[0] < 0.005  # T and M share their origin: the tool turns on the spot


async def test_paper_form_is_right_for_parallel_frames_and_wrong_by_the_mount_otherwise() -> None:
    """(7) is in camera axes, (8) applies it in tool axes."""
    paper = SETTINGS.model_copy(update={"form": "paper"})
    parallel = rig(
        3, X_TC=transform(np.eye(3), [-0.2, -0.05, -0.4]), X_TM=transform(np.diag([1.0, -1, -1]), [0] * 3)
    )
    await adjust_orientation(parallel, parallel, silent, paper)
    assert parallel.true_orientation_error() < np.radians(0.3)
    turned = rig(3, X_TC=transform(exp_so3(np.radians([0.0, 0.0, 20.0])), [-0.2, -0.05, -0.4]))
    before = turned.true_orientation_error()
    await adjust_orientation(turned, turned, silent, paper)
    # the turn's axis is off by 20°, so that 2 sin 10° of it is left over
    assert turned.true_orientation_error() == pytest.approx(2.0 * np.sin(np.radians(10.0)) * before, rel=0.4)


async def test_repetition_looks_again_and_leaves_no_more() -> None:
    arm = rig(5)
    result = await adjust_orientation(arm, arm, silent, SETTINGS.model_copy(update={"repetitions": 3}))
    assert len(result.errors) == 4
    assert len(result.references) == 3
    assert arm.true_orientation_error() < np.radians(0.25)


async def test_a_turn_beyond_the_limit_is_refused_and_nothing_moves() -> None:
    arm = rig(2)
    before = arm.motions
    with pytest.raises(MeasurementFailed) as refused:
        await adjust_orientation(arm, arm, silent, SETTINGS.model_copy(update={"limit_deg": 0.5}))
    assert refused.value.cause == "measurement.turn_too_large"
    assert arm.motions == before


async def test_error_is_zero_only_for_parallel_markers() -> None:
    look = await rig(4).look()
    assert np.allclose(orientation_error(look._replace(X_CO=look.X_CM)), 0.0, atol=1e-12)
    turned = look._replace(X_CO=look.X_CM @ transform(exp_so3([0.1, 0.0, 0.0]), [0.0] * 3))
    assert np.allclose(orientation_error(turned), [0.1, 0.0, 0.0], atol=1e-9)
