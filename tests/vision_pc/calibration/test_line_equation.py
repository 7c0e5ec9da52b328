"""Line equation on the synthetic arm: circle, direction, reference, and what it refuses."""

import math

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.program_settings import shipped
from tests.vision_pc.synthetic import Q_START, SyntheticRig, Truth, draw, forward, silent
from vision_pc.core.calibration.line_equation import circle, line_equation, solve
from vision_pc.core.se3 import transform
from vision_pc.core.types import WatchSample

SETTINGS = shipped().line_equation
FIT = SETTINGS.model_copy(update={"minimum": "fit"})


def truth(seed: int, **changes: object) -> Truth:
    """Parallel frames, as the method assumes; the object in the tool's n-s directions."""
    X_TC = transform(np.eye(3), [-0.2, -0.05, -0.4])
    X_TM = transform(np.diag([1.0, -1.0, -1.0]), [0.0] * 3)
    return draw(np.random.default_rng(seed), **({"X_TC": X_TC, "X_TM": X_TM} | changes))


def perfect(at: tuple[float, float], **changes: object) -> SyntheticRig:
    """A rigid arm without any error, the object at ``at`` in the n-s plane, 0.5 m ahead."""
    zero = dict.fromkeys(
        ("play", "servo_std", "marker_std_m", "marker_std", "odometry_std_m", "odometry_std"), 0.0
    )
    X_BO = forward(Q_START) @ transform(np.diag([1.0, -1.0, -1.0]), [*at, 0.5])
    exact = {"encoder_offset": np.zeros(6), "compliance": np.zeros(2), "X_BO": X_BO}
    return SyntheticRig(truth(0, **(zero | exact | changes)), 0)


def test_circle_has_18_points_in_the_n_s_plane_first_and_last_at_the_centre() -> None:
    X = forward(Q_START)
    points = circle(X, 0.2, 18)
    assert len(points) == 18
    assert np.allclose(points[0], X)
    assert np.allclose(points[-1], X)
    for P in points[1:-1]:
        offset = P[:3, 3] - X[:3, 3]
        assert np.linalg.norm(offset) == pytest.approx(0.2)
        assert offset @ X[:3, 2] == pytest.approx(0.0, abs=1e-12)
        assert np.allclose(P[:3, :3], X[:3, :3])
    assert np.allclose(points[1][:3, 3] - X[:3, 3], 0.2 * X[:3, 0])
    assert np.allclose(points[1], points[16])  # φ from 0 to 2π, both included


@pytest.mark.parametrize("angle_deg", [0.0, 37.0, 90.0, 150.0, 215.0, 300.0])
@pytest.mark.parametrize("settings", [SETTINGS, FIT], ids=["sample", "fit"])
async def test_a_perfect_arm_arrives(angle_deg: float, settings: object) -> None:
    at = (0.6 * math.cos(math.radians(angle_deg)), 0.6 * math.sin(math.radians(angle_deg)))
    arm = perfect(at)
    result = await line_equation(arm, arm, silent, settings)  # type: ignore[arg-type]
    error = np.linalg.norm(arm.true_error(0.1)[:2])
    assert result.distance_m == pytest.approx(0.4, abs=0.005)
    # a direction from one sample is known to half their spacing of up to 9°; the fit interpolates
    assert error < (0.001 if settings is FIT else 0.07)
    assert abs(arm.true_error(0.0)[2] - 0.5) < 1e-6  # depth is not treated


async def test_the_fit_is_better_than_the_sample_in_the_mean_over_seeds() -> None:
    errors: dict[str, list[float]] = {"sample": [], "fit": []}
    for seed in range(8):
        for settings in (SETTINGS, FIT):
            arm = SyntheticRig(truth(seed, X_BO=perfect((0.5, 0.3)).truth.X_BO), seed)
            await line_equation(arm, arm, silent, settings)
            errors[settings.minimum].append(float(np.linalg.norm(arm.true_error(0.1)[:2])))
    assert np.mean(errors["fit"]) < np.mean(errors["sample"])
    assert np.mean(errors["sample"]) > 0.005  # as in the paper: not reliably inside the tolerance


def test_the_fit_sets_pictures_aside_in_which_another_thing_was_taken_for_the_object() -> None:
    at, turned = np.array([0.5, 0.3, 0.0]), np.linspace(0.0, 2.0 * np.pi, 24)
    samples = []
    for k, place in enumerate(
        SETTINGS.radius_m * np.column_stack([np.cos(turned), np.sin(turned), 0.0 * turned])
    ):
        off = [0.2, 0.0, 0.0] if k in (5, 11) else [0.0] * 3
        X_CO = transform(np.eye(3), at - place + off)
        samples.append(WatchSample(k, transform(np.eye(3), place), None, np.eye(4), X_CO))
    found = solve(tuple(samples), np.eye(4), FIT)
    assert np.linalg.norm(found.X_BT_ref[:3, 3] - at) < 2e-3


@pytest.mark.parametrize("at", [(0.08, 0.05), (0.15, 0.0), (-0.08, -0.07), (-0.1, 0.15)])
async def test_an_object_within_the_circle_is_refused(at: tuple[float, float]) -> None:
    for settings in (SETTINGS, FIT):
        arm = perfect(at)
        with pytest.raises(MeasurementFailed) as refused:
            await line_equation(arm, arm, silent, settings)
        assert refused.value.cause == "measurement.object_inside_circle"


async def test_markers_out_of_view_are_refused() -> None:
    arm = SyntheticRig(truth(1, missed_share=0.6), 1)
    with pytest.raises(MeasurementFailed) as refused:
        await line_equation(arm, arm, silent, SETTINGS)
    assert refused.value.cause == "measurement.marker_lost"
    blind = perfect((0.5, 0.0))
    blind.blind_object = True
    with pytest.raises(MeasurementFailed) as refused:
        await line_equation(blind, blind, silent, SETTINGS)
    assert refused.value.cause == "measurement.marker_lost"


async def test_a_step_beyond_the_limit_is_refused_after_the_circle() -> None:
    arm = perfect((0.7, 0.0))
    with pytest.raises(MeasurementFailed) as refused:
        await line_equation(arm, arm, silent, SETTINGS.model_copy(update={"step_limit_m": 0.4}))
    assert refused.value.cause == "measurement.step_too_large"
    assert np.allclose((await arm.view()).X_BT, forward(Q_START), atol=1e-3)
