"""All hand-eye methods timed in one run: ``make bench ARGS="-k hand_eye"``."""

from functools import partial

import numpy as np
import pytest

from laboratory.experiments.hand_eye import scenes
from tests.benchmarks.turns import least_in_turn
from vision_pc.config.choices import Method
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import methods

pytestmark = pytest.mark.bench

LIMIT = 6.0  # times one maximum-likelihood solution of all samples


def samples(count: int, bad: int = 0) -> PosePairs:
    rng = np.random.default_rng([70, count])
    scene = scenes.viewing_scene(rng, count)
    return scenes.measured_with_bad(scene, scenes.noise(0.1, 0.5), rng, bad)[0]


@pytest.mark.parametrize(("count", "bad"), [(12, 2), (15, 2), (20, 4), (30, 6)])
def test_time_of_the_robust_solver(count: int, bad: int) -> None:
    pairs = samples(count, bad)
    assert (~methods.solve(pairs, Method.ROBUST).inliers).sum() == bad
    works = (partial(methods.solve, pairs, method) for method in (Method.ROBUST, Method.MAXIMUM_LIKELIHOOD))
    robust_s, plain_s = least_in_turn(*works)
    times, which = robust_s / plain_s, f"{count} samples, {bad} bad: {1e3 * robust_s:.1f} ms"
    print(f"\n{which}, {times:.1f} of {LIMIT:g} times a plain solution")
    assert times <= LIMIT
