"""The survey: short steps are not divided, and nothing that matters is missed."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from controller.core.kinematics.denavit_hartenberg import tool_pose
from controller.core.kinematics.inverse_kinematics import REACHED, geometry, solve
from controller.core.kinematics.rotations import Array, quaternion_from_matrix, rows
from controller.core.references import admission
from controller.core.settings import ScanSettings
from controller.core.trajectories.path_survey import (
    JOINT_SPEED,
    PlanningLimits,
    Survey,
    survey,
    survey_straight,
)
from controller.core.trajectories.paths import Path, at_rest, path_from, pose_on_segment
from controller.core.trajectories.workspace import WorkspaceBounds, opened
from protocol.faults import Reason
from protocol.reference_messages import ReferencePath
from tests.controller.obedient_plant import Bench


def _straight(limits: PlanningLimits, q: Array, turned: Array) -> Path:
    """The straight way from joint angles ``q`` to ``q + turned``, in a second."""
    begin, end = tool_pose(limits.table, q), tool_pose(limits.table, q + turned)
    start = at_rest(begin[:3, 3].copy(), quaternion_from_matrix(begin[:3, :3].copy()))
    goal = quaternion_from_matrix(end[:3, :3].copy())
    return path_from(start, end[:3, 3][None].copy(), goal[None], np.ones(1), 0.0)


def _degrees(least: float, most: float) -> st.SearchStrategy[float]:
    return st.floats(math.radians(least), math.radians(most))


BOOM = st.tuples(_degrees(-60, 60), _degrees(20, 70), _degrees(-100, -40))
WRIST = st.tuples(_degrees(-90, 90), _degrees(-30, 30), _degrees(-90, 90))


@given(boom=BOOM, wrist=WRIST, turned=st.lists(_degrees(-20, 20), min_size=6, max_size=6))
def test_with_peaks_and_without_the_survey_finds_the_same(
    settings: ScanSettings,
    boom: tuple[float, float, float],
    wrist: tuple[float, float, float],
    turned: list[float],
) -> None:
    limits = settings.planning
    q = np.array([*boom, *wrist])
    path = _straight(limits, q, np.array(turned))
    found = survey(limits, path, q)
    start, end = path.sample(0.0)[0], path.sample(1.0)[0]
    reason, *numbers = survey_straight(limits, start.p, start.quaternion, (end.p, end.quaternion), q)
    assert reason is found.reason
    assert numbers == pytest.approx(found[1:3], abs=1e-9)


@given(
    boom=BOOM,
    wrist=st.tuples(_degrees(-40, 40), _degrees(8, 30), _degrees(-60, 60)),
    turned=st.tuples(*(_degrees(-most, most) for most in (10, 5, 5, 40, 3, 40))),
)
def test_undivided_short_steps_hide_neither_obstacles_nor_joint_speeds(
    settings: ScanSettings,
    boom: tuple[float, float, float],
    wrist: tuple[float, float, float],
    turned: tuple[float, ...],
) -> None:
    """Against angles at 1,200 instants, where the wrist is bent enough to be servoed exactly."""
    limits = settings.planning
    q = np.array([*boom, *wrist])
    path = _straight(limits, q, np.array(turned))
    found = survey(limits, path, q)
    assume(found.reason is Reason.ACCEPTED)
    arm, last, count = geometry(limits.table), tuple(q.tolist()), 1_200
    most = 0.0
    for k in range(1, count + 1):
        p, quaternion = pose_on_segment(path, 0, k / count)
        verdict, angles, _, _ = solve(arm, rows(quaternion), p, last)
        assume(abs(math.sin(angles[4] + arm.offsets[4])) > math.sin(math.radians(4.6)))
        assert verdict == REACHED
        steps = np.abs(np.array(angles) - last)
        assert steps.max() < 0.05, "a flip between two samples"
        most = max(most, float((count * steps / limits.joint_speeds).max()))
        last = angles
    assert found.peaks[0, JOINT_SPEED] >= 0.99 * most - 1e-6


def test_a_path_from_a_moving_state_is_surveyed_whole_no_more_than_twice(
    settings: ScanSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long it takes to find a duration for its first segment: one scan has to bear it."""
    bench = Bench(settings).moving()
    counts: list[int] = []

    def counted(limits: PlanningLimits, path: Path, q_start: Array) -> Survey:
        counts.append(len(path.durations))
        return survey(limits, path, q_start)

    monkeypatch.setattr(admission, "survey", counted)
    # Against the present speed the first guess is too short several times.
    poses = tuple(bench.shifted(z=-0.02 * (k % 5), y=0.01 * k) for k in range(1, 25))
    found = admission.admit(
        settings, bench.state.motion.desired, bench.state.watch.q_meas, ReferencePath(1, poses, 0.0, 0.0)
    )
    assert isinstance(found, Path)
    assert counts[0] == counts[-1] == 24
    assert len(counts) > 3
    assert set(counts[1:-1]) == {1}
    assert survey(settings.planning, found, bench.state.watch.q_meas).reason is Reason.ACCEPTED


@pytest.mark.parametrize(
    ("p", "box", "radius"),
    [
        ((0.2, -3.0, 4.0), [[0.2, 2.0], [-3.0, 1.0], [0.0, 4.0]], 0.5),
        ((0.1, 0.2, 1.0), [[0.1, 2.0], [-1.0, 1.0], [0.0, 3.0]], math.hypot(0.1, 0.2)),
        ((5.0, 5.0, -5.0), [[1.0, 5.0], [-1.0, 5.0], [-5.0, 3.0]], 0.5),
    ],
)
def test_the_workspace_opens_for_an_arm_that_stands_outside(
    p: tuple[float, float, float], box: list[list[float]], radius: float
) -> None:
    space = WorkspaceBounds(np.array([[1.0, 2.0], [-1.0, 1.0], [0.0, 3.0]]), 0.5)
    widened = opened(space, np.array(p))
    assert widened.box.tolist() == box
    assert widened.radius_min == radius
