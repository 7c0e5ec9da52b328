"""All hand-eye methods timed in one run: ``make bench ARGS="-k hand_eye"``."""

import timeit
from typing import Any

import numpy as np
import pytest

from laboratory.experiments.hand_eye import scenes
from vision_pc.config.choices import Method
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import methods

pytestmark = pytest.mark.bench

LIMIT = 6.0  # times one maximum-likelihood solution of all samples


def samples(count: int, bad: int = 0) -> PosePairs:
    rng = np.random.default_rng([70, count])
    scene = scenes.viewing_scene(rng, count)
    return scenes.measured_with_bad(scene, scenes.noise(0.1, 0.5), rng, bad)[0]


@pytest.mark.benchmark(group="hand-eye, robust with bad samples")
@pytest.mark.parametrize(("count", "bad"), [(12, 2), (15, 2), (20, 4), (30, 6)])
def test_bench_hand_eye_robust(benchmark: Any, count: int, bad: int) -> None:
    pairs = samples(count, bad)
    result = benchmark(methods.solve, pairs, Method.ROBUST)
    assert (~result.inliers).sum() == bad
    plain_s = min(timeit.repeat(lambda: methods.solve(pairs, Method.MAXIMUM_LIKELIHOOD), number=1, repeat=30))
    print(f"\n{benchmark.stats['min'] / plain_s:.1f} times a plain solution, limit {LIMIT:g}")
    assert benchmark.stats["min"] <= LIMIT * plain_s
