"""Coarse alignment and hybrid mixture: how often they find a random frame, and what they refuse."""

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from vision_pc.core.point_set_matching.coarse import asymmetry, coarse_alignment, path_frame
from vision_pc.core.point_set_matching.hybrid_mixture import (
    PoseSet,
    _concentration,
    full_poses,
    match_trajectories,
    positions_only,
)
from vision_pc.core.se3 import Array, angle_between, exp_so3, nearest_rotation, rotation_from_quaternion

ASYMMETRIC, ZIGZAG, STRAIGHT = (0.30, 0.10, 0.05, 0.30), (0.2,) * 5, (0.8,)


def path(segments: tuple[float, ...], count: int = 80) -> Array:
    """``count`` points along a 0/45° path."""
    corners = [np.zeros(3)]
    for i, length in enumerate(segments):
        xi = np.pi / 4 if i % 2 else 0.0
        corners.append(corners[-1] + length * np.array([np.cos(xi), np.sin(xi), 0.0]))
    at = np.linspace(0.0, sum(segments), count)
    ends = np.concatenate([[0.0], np.cumsum(segments)])
    return np.column_stack([np.interp(at, ends, np.array(corners)[:, k]) for k in range(3)])


def circle(count: int = 80) -> Array:
    a = np.linspace(0.0, 2.0 * np.pi, count)
    return np.column_stack([0.2 * np.cos(a), 0.2 * np.sin(a), 0.0 * a])


def random_rotation(rng: np.random.Generator) -> Array:
    return rotation_from_quaternion(rng.normal(size=4))


class Case:
    """One random frame: camera poses ``x``, ``n`` of a path, kinematic poses ``y``, ``v``, 5 % glitches."""

    def __init__(self, points: Array, seed: int, body: Array | None = None, glitches: float = 0.05) -> None:
        rng = np.random.default_rng(seed)
        self.R = random_rotation(rng)
        held = np.array([exp_so3(rng.normal(0, 0.01, 3)) for _ in points])
        self.y = points + rng.normal(0, 0.002, points.shape)
        self.v = held
        self.x = points @ self.R.T + rng.normal(0, 1.0, 3) + rng.normal(0, 0.001, points.shape)
        mount = np.eye(3) if body is None else body
        self.n = np.array([self.R @ r @ mount @ exp_so3(rng.normal(0, 0.005, 3)) for r in held])
        for k in np.nonzero(rng.random(len(points)) < glitches)[0]:
            self.x[k] += rng.normal(0, 0.3, 3)
            self.n[k] = random_rotation(rng)

    def error_deg(self, R: Array) -> float:
        return float(np.degrees(angle_between(R, self.R)))

    def coarse(self) -> Array:
        return coarse_alignment(self.x, self.y).T

    def positions(self) -> tuple[PoseSet, PoseSet]:
        return positions_only(self.x), positions_only(self.y)

    def poses(self) -> tuple[PoseSet, PoseSet]:
        return full_poses(self.x, self.n), full_poses(self.y, self.v)


@pytest.mark.parametrize("form", ["positions", "poses"])
@pytest.mark.parametrize("associated", [True, False])
def test_asymmetric_path_60_of_60_random_frames_under_2_degrees(form: str, associated: bool) -> None:
    errors = []
    for seed in range(60):
        case = Case(path(ASYMMETRIC), seed)
        data, model = case.positions() if form == "positions" else case.poses()
        errors.append(case.error_deg(match_trajectories(data, model, case.coarse(), associated=associated).R))
    assert sum(e < 2.0 for e in errors) == 60, sorted(errors)[-5:]


@pytest.mark.parametrize(
    "points", [circle(), path(STRAIGHT), path(ZIGZAG)], ids=["circle", "straight", "zigzag"]
)
def test_directions_alone_start_the_match_where_no_coarse_frame_exists(points: Array) -> None:
    errors = []
    for seed in range(20):
        case = Case(points, seed)
        data, model = case.poses()
        start = nearest_rotation(data.directions.mean(axis=0).T @ model.directions.mean(axis=0))
        errors.append(case.error_deg(match_trajectories(data, model, start, associated=False).R))
    assert max(errors) < 2.0


def test_without_coarse_alignment_half_the_unassociated_matches_are_wrong() -> None:
    """What coarse alignment is for: without it a planar path flips."""
    errors = []
    for seed in range(20):
        case = Case(path(ASYMMETRIC), seed)
        errors.append(case.error_deg(match_trajectories(*case.positions(), np.eye(3), associated=False).R))
    assert sum(e > 90.0 for e in errors) >= 5


def test_body_rotation_biases_poses_by_itself_but_not_positions() -> None:
    body = exp_so3(np.radians([0.0, 15.0, 0.0]))
    biased, clean = [], []
    for seed in range(10):
        case = Case(path(ASYMMETRIC), seed, body)
        start = case.coarse()
        clean.append(case.error_deg(match_trajectories(*case.positions(), start, associated=True).R))
        biased.append(case.error_deg(match_trajectories(*case.poses(), start, associated=False).R))
    assert np.median(clean) < 0.5
    assert 5.0 < np.median(biased) < 16.0


def test_outliers_are_named() -> None:
    case = Case(path(ASYMMETRIC), 3, glitches=0.0)
    bad = [7, 30, 55]
    case.x[bad] += 0.4
    match = match_trajectories(*case.positions(), case.coarse(), associated=True)
    assert set(np.nonzero(match.inlier < 0.5)[0]) == set(bad)
    assert match.outlier_share == pytest.approx(3 / 80, abs=0.01)
    assert match.converged
    assert match.sigma_m == pytest.approx(np.hypot(0.001, 0.002), rel=0.2)


def test_exact_data_gives_the_exact_frame() -> None:
    points = path(ASYMMETRIC)
    R, t = exp_so3([0.3, -2.0, 0.7]), np.array([1.0, -2.0, 3.0])
    match = match_trajectories(
        positions_only(points @ R.T + t), positions_only(points),
        coarse_alignment(points @ R.T + t, points).T, associated=True,
    )  # fmt: skip
    assert np.allclose(match.R, R, atol=1e-9)
    assert np.allclose(match.t, t, atol=1e-9)


@pytest.mark.parametrize("kappa", [0.01, 0.5, 3.0, 40.0, 250.0, 5e3])
def test_concentration_solves_its_equation(kappa: float) -> None:
    mean_cosine = 1.0 / np.tanh(kappa) - 1.0 / kappa
    assert _concentration(mean_cosine) == pytest.approx(kappa, rel=1e-3)


def test_coarse_frames_agree_under_any_rotation_and_are_right_handed() -> None:
    points = path(ASYMMETRIC)
    for seed in range(20):
        R = random_rotation(np.random.default_rng(seed))
        F, G = path_frame(points), path_frame(points @ R.T + 0.5)
        assert np.linalg.det(F) == pytest.approx(1.0)
        assert np.allclose(G, R @ F, atol=1e-9)


@pytest.mark.parametrize(
    ("points", "cause"),
    [
        (path(STRAIGHT), "measurement.path_straight"),
        (circle(), "measurement.path_closed"),
        (path(ZIGZAG), "measurement.path_symmetric"),
        (np.zeros((20, 3)), "measurement.path_too_short"),
        (np.zeros((3, 3)), "measurement.too_few_samples"),
    ],
)
def test_paths_without_a_frame_are_refused(points: Array, cause: str) -> None:
    with pytest.raises(MeasurementFailed) as refused:
        path_frame(points)
    assert refused.value.cause == cause


def test_asymmetry_tells_the_mirrored_twin() -> None:
    assert asymmetry(path(ZIGZAG)) < 0.005
    assert asymmetry(path((0.2,) * 4)) < 0.005  # mirrored across its chord, end for end
    assert asymmetry(path(ASYMMETRIC)) > 0.03


@pytest.mark.parametrize(("n", "m", "cause"), [(3, 80, "too_few_samples"), (79, 80, "not_associated")])
def test_wrong_counts_are_refused(n: int, m: int, cause: str) -> None:
    points = path(ASYMMETRIC)
    with pytest.raises(MeasurementFailed) as refused:
        match_trajectories(positions_only(points[:n]), positions_only(points[:m]), np.eye(3), associated=True)
    assert refused.value.cause == f"measurement.{cause}"
