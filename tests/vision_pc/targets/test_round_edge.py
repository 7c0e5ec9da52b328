"""The circle through edge points, where there is none."""

import numpy as np
import pytest

from vision_pc.core.targets import round_edge
from vision_pc.core.targets.target import TargetRefused


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seed", [131, 232, 401, 770])
def test_points_that_a_circle_loses_as_it_is_fitted_are_refused_without_a_word_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.0, 2.0 * np.pi, 60)
    far = 0.02 * (1.0 + rng.normal(0.0, rng.choice([0.05, 0.2, 0.5]), 60))
    points = np.column_stack([far * np.cos(angle), far * np.sin(angle)]) + rng.uniform(-0.02, 0.02, 2)
    with pytest.raises(TargetRefused) as refused:
        round_edge._fit_circle(points, 2e-4)
    assert refused.value.cause == "target.not_round"
