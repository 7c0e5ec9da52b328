"""Odometry's lengths against the look's: what the object's markers tell along the legs."""

from typing import Any

import numpy as np
import pytest

from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.synthetic import Q_START, SyntheticRig, draw, forward, silent
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.local_error_model import record_local_track, three_legs
from vision_pc.core.calibration.odometry_ruler import Ruler, fitted_ruler
from vision_pc.core.calibration.orientation import adjust_orientation
from vision_pc.core.positioning.corrected_positioning import CorrectedResult, look_then_move_corrected
from vision_pc.core.se3 import Array, exp_so3, transform

PROGRAMS = shipped()


def settings(enabled: bool = True) -> LocalErrorModelSettings:
    parts: dict[str, Any] = PROGRAMS.local_map.model_dump()
    parts["ruler"] |= {"enabled": enabled}
    return LocalErrorModelSettings.model_validate(parts)


def legs(E: Array, rng: np.random.Generator, noise_m: float = 2e-4) -> tuple[Array, Array]:
    """Poses by odometry whose positions are (I + E)⁻¹ of the look's, and where the object is seen."""
    X = forward(Q_START)
    corners = np.array([X[:3, :3].T @ (P[:3, 3] - X[:3, 3]) for P in three_legs(X, 0.2)])
    at = np.linspace(0.0, 3.0, 90)
    places = np.column_stack([np.interp(at, range(4), corners[:, axis]) for axis in range(3)])
    turns = [exp_so3(rng.normal(0.0, 2e-3, 3)) for _ in places]
    o = np.array([0.1, -0.2, 1.1])
    by_odometry = np.linalg.solve(np.eye(3) + E, places.T).T
    X_KC = np.array([transform(R, p) for R, p in zip(turns, by_odometry, strict=True)])
    seen = np.array([R.T @ (o - p) for R, p in zip(turns, places, strict=True)])
    return X_KC, seen + rng.normal(0.0, noise_m, seen.shape)


@pytest.mark.parametrize("size", [0.0, 3e-3, 1e-2])
def test_what_odometry_is_off_is_found_and_told(size: float) -> None:
    rng = np.random.default_rng(3)
    squares, errors = [], []
    for _ in range(20):
        E = size * rng.uniform(-1.0, 1.0, (3, 3))
        ruler = fitted_ruler(*legs(E, rng), settings().ruler)
        assert ruler is not None
        off = ruler.E - E
        pairs = zip(off, ruler.covariances, strict=True)
        squares += [float(row @ np.linalg.solve(cov, row)) / 3.0 for row, cov in pairs]
        errors.append(np.abs(off).max())
    assert np.median(errors) < 1.5e-3
    assert np.mean(squares) < 1.3  # ninety sightings are told as the worth of twelve


def test_noise_alone_changes_next_to_nothing() -> None:
    rng = np.random.default_rng(4)
    found = [fitted_ruler(*legs(np.zeros((3, 3)), rng, 4e-4), settings().ruler) for _ in range(20)]
    sizes = [np.abs(ruler.E).max() for ruler in found if ruler is not None]
    assert len(sizes) == 20
    assert np.median(sizes) < 4e-4


def test_a_glitch_and_pictures_without_the_object_do_not_count() -> None:
    rng = np.random.default_rng(5)
    E = np.diag([8e-3, 5e-3, 0.0])
    X_KC, seen = legs(E, rng)
    seen[::7] = np.nan
    seen[3:80:11] += 0.1
    ruler = fitted_ruler(X_KC, seen, settings().ruler)
    assert ruler is not None
    assert np.abs(ruler.E - E).max() < 2.5e-3


def test_an_object_that_is_hardly_seen_tells_nothing() -> None:
    X_KC, seen = legs(np.eye(3) * 1e-2, np.random.default_rng(6))
    seen[8:] = np.nan
    assert fitted_ruler(X_KC, seen, settings().ruler) is None
    X_KC, seen = legs(np.eye(3) * 1e-2, np.random.default_rng(6))
    X_KC[:, :3, 3] *= 0.05
    assert fitted_ruler(X_KC, seen, settings().ruler) is None


def test_what_is_told_of_a_way_grows_with_it_and_with_what_may_be_otherwise() -> None:
    ruler = Ruler(np.diag([1e-2, 0.0, 0.0]), np.tile(1e-6 * np.eye(3), (3, 1, 1)), 0.3)
    spread = ruler.covariance(np.array([0.5, 0.0, 0.0]))
    assert spread[0, 0] == pytest.approx((0.5e-3) ** 2 + (0.3 * 5e-3) ** 2)
    assert spread[1, 1] == pytest.approx((0.5e-3) ** 2)


async def one_look(arm: SyntheticRig, local_map: LocalErrorModelSettings) -> CorrectedResult:
    await adjust_orientation(arm, arm, silent, PROGRAMS.orientation)
    track = await record_local_track(arm, arm, silent, local_map, BOOM)
    return await look_then_move_corrected(arm, arm, silent, PROGRAMS.positioning, local_map, BOOM, track)


async def test_the_tool_ends_where_the_look_wanted_it_though_odometry_is_long() -> None:
    errors: dict[bool, list[float]] = {True: [], False: []}
    for seed in (10, 12, 16, 20):
        for enabled in (True, False):
            truth = draw(np.random.default_rng(seed), servo_std=5e-5, odometry_scale=1.008)
            arm = SyntheticRig(truth, seed)
            result = await one_look(arm, settings(enabled))
            error = arm.true_error(PROGRAMS.positioning.clearance_m)[:2]
            errors[enabled].append(float(np.abs(error).max()))
            if enabled:
                assert (np.abs(error) < 3.5 * result.seen.std_m[:2] + 1e-3).all()
    assert np.mean(errors[True]) < 0.5 * np.mean(errors[False]), errors
