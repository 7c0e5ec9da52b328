"""Targets go along with looks and watches: told what was seen, lost where a watch fails or nobody watched."""

import contextlib
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from protocol.errors import LinkLost, RequestRefused
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS
from vision_pc.application.targets.carrier import AimedSensor, TargetCarrier
from vision_pc.core.se3 import Array, to_pose, transform
from vision_pc.core.targets.keeper import TargetKeeper
from vision_pc.core.targets.target import TargetObservation
from vision_pc.core.types import Look

FAR = transform(np.eye(3), np.array([0.1, 0.0, 1.0]))


def shifted(x_m: float) -> Array:
    return transform(np.eye(3), np.array([x_m, 0.0, 0.0]))


class Bench:
    """A keeper with one target that is aimed at, and a controller whose tool can be put anywhere."""

    def __init__(self) -> None:
        config = load_settings(CONFIGS, {}).vision
        self.targets = TargetKeeper(config.targets)
        self.sensor = AimedSensor(config, self.targets)
        self.states: Any = SimpleNamespace(state=SimpleNamespace(X_BT=to_pose(np.eye(4))))
        self.carrier = TargetCarrier(self.targets, self.sensor, self.states)
        seen: Any = SimpleNamespace(
            kind="plane",
            X_CO=FAR,
            covariance=1e-8 * np.eye(6),
            diameter_m=None,
            quality=1.0,
            outline=None,
        )
        self.kept = self.targets.add(cast(TargetObservation, seen), 1, np.eye(4), None)

    def drive(self, x_m: float) -> None:
        self.states.state.X_BT = to_pose(shifted(x_m))


def test_a_watched_motion_carries_the_target_and_tells_how_far() -> None:
    bench = Bench()
    assert bench.carrier.carries
    with bench.carrier.watching() as watched:
        assert not bench.carrier.carries  # who watches already need not watch again
        bench.drive(0.2)
        watched((cast(Any, SimpleNamespace(X_C0C=shifted(0.2))),))
    assert (bench.kept.known, bench.kept.way_m) == ("carried", pytest.approx(0.2))
    assert np.allclose(bench.kept.X_CO[:3, 3], [-0.1, 0.0, 1.0])
    assert bench.kept.covariance[0, 0] > 1e-8
    with bench.carrier.looking() as looked:
        assert bench.sensor.resting
        bench.sensor.measured = 4
        looked(cast(Look, SimpleNamespace(X_CO=FAR, cov_CO=np.eye(6), X_BT=shifted(0.2), frames=5)))
    assert not bench.sensor.resting
    assert bench.kept.known == "measured"


@pytest.mark.parametrize("fails", [True, False])
def test_a_watch_that_fails_or_lost_its_way_loses_the_target(fails: bool) -> None:
    bench = Bench()
    with contextlib.suppress(LinkLost), bench.carrier.watching() as watched:
        bench.drive(0.2)
        if fails:
            raise LinkLost("link.camera_silent", "no picture")
        watched((cast(Any, SimpleNamespace(X_C0C=None)),))
    assert bench.kept.known == "lost"
    with pytest.raises(RequestRefused) as refused, bench.carrier.looking():
        pytest.fail("looked at a target that nobody knows")
    assert refused.value.cause == "refused.target_lost"
