"""Pictures of a camera on a boom that rocks: how many are waited for, and what their mean is worth."""

import math

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.synthetic import SyntheticRig, draw, silent
from vision_pc.config.programs import AtRestSettings, LocalErrorModelSettings
from vision_pc.core.calibration.camera_at_rest import AtRest, at_rest, begun_at, tracked
from vision_pc.core.calibration.local_error_model import (
    record_local_track,
    three_legs,
    track_of,
    watched_path,
)
from vision_pc.core.calibration.take_up import first_take_up
from vision_pc.core.se3 import Array, transform
from vision_pc.core.types import WatchSample

ROCKS_M, ROCKS_HZ = 1e-3, 2.3
SIXTEEN = AtRestSettings(pictures=16, agree_m=3e-4, patience_s=5.0)
ONE = SIXTEEN.model_copy(update={"pictures": 1})


def _at(x: float) -> Array:
    return transform(np.eye(3), np.array([x, 0.0, 0.0]))


class RockingWatch:
    """A picture every tenth of a second of a camera that rocks, ever less by ``decay_s``; some are lost."""

    health = None

    def __init__(self, decay_s: float, lost: tuple[int, ...] = ()) -> None:
        self.samples: tuple[WatchSample, ...] = ()
        self._decay_s, self._lost = decay_s, lost
        self._add()

    def _add(self) -> None:
        k = len(self.samples)
        x = ROCKS_M * math.exp(-0.1 * k / self._decay_s) * math.cos(0.2 * math.pi * ROCKS_HZ * k)
        pose = None if k in self._lost else _at(x)
        self.samples += (WatchSample(k * 100_000_000, np.eye(4), pose, None, None),)

    async def after(self, count: int, timeout_s: float) -> WatchSample | None:
        assert timeout_s > 0.1
        self._add()
        return self.samples[-1] if len(self.samples) > count else None


class SilentWatch(RockingWatch):
    async def after(self, count: int, timeout_s: float) -> WatchSample | None:
        return None


async def test_one_picture_is_taken_as_it_is() -> None:
    watch = RockingWatch(1.0)
    assert await at_rest(watch, ONE) == AtRest(slice(0, 1), 0.0)  # type: ignore[arg-type]
    assert len(watch.samples) == 1


async def test_as_many_as_asked_for_are_waited_for_and_lost_ones_do_not_count() -> None:
    watch = RockingWatch(1.0, lost=(3, 5))
    found = await at_rest(watch, SIXTEEN)  # type: ignore[arg-type]
    assert found.pictures == slice(0, 16)
    assert len(watch.samples) == 18
    assert found.apart_m < SIXTEEN.agree_m
    later = await at_rest(watch, SIXTEEN, before=len(watch.samples))  # type: ignore[arg-type]
    assert later.pictures == slice(16, 32)


async def test_a_camera_that_does_not_rest_is_given_up_and_by_how_much_is_told() -> None:
    class Drifting(RockingWatch):
        def _add(self) -> None:
            k = len(self.samples)
            self.samples += (WatchSample(k * 100_000_000, np.eye(4), _at(1e-3 * k), None, None),)

    watch = Drifting(1.0)
    found = await at_rest(watch, SIXTEEN)  # type: ignore[arg-type]
    assert 0.1 * len(watch.samples) == pytest.approx(SIXTEEN.patience_s, abs=0.3)
    assert found.apart_m == pytest.approx(8e-3, rel=0.05)
    silent_watch = SilentWatch(1.0)
    assert (await at_rest(silent_watch, SIXTEEN)).pictures == slice(0, 1)  # type: ignore[arg-type]


async def test_a_track_begins_with_the_mean_of_what_rested() -> None:
    watch = RockingWatch(1e9)
    found = await at_rest(watch, SIXTEEN)  # type: ignore[arg-type]
    samples = list(watch.samples)
    samples += [WatchSample((16 + k) * 100_000_000, np.eye(4), _at(0.5), None, None) for k in range(8)]
    rested = begun_at(tracked(watch.samples), found, SIXTEEN.agree_m)
    first, mean = (track_of(tuple(samples), begun).X_KC[0, 0, 3] for begun in (None, rested))
    assert first == pytest.approx(-0.5 + ROCKS_M)
    assert mean == pytest.approx(-0.5, abs=0.2 * ROCKS_M)


class SinkingWatch(RockingWatch):
    """The same camera on a boom that sinks through the play before its encoder while it rocks."""

    sinks_m_s = 0.0

    def _add(self) -> None:
        super()._add()
        rocked, time_s = self.samples[-1], 0.1 * (len(self.samples) - 1)
        assert rocked.X_C0C is not None
        sunk = _at(rocked.X_C0C[0, 3] + self.sinks_m_s * min(time_s, 4.0))
        self.samples = (*self.samples[:-1], rocked._replace(X_C0C=sunk))


@pytest.mark.parametrize("sinks_m_s", [5e-4, 1e-3])
async def test_what_a_boom_sinks_before_its_drive_is_a_part_of_the_way(sinks_m_s: float) -> None:
    """The goal was told where the watch began, not where the camera has come to rest until the drive."""
    watch = SinkingWatch(0.5)
    watch.sinks_m_s = sinks_m_s
    found = await at_rest(watch, SIXTEEN)  # type: ignore[arg-type]
    assert found.pictures.start > 20, "it waits until it no longer sinks"
    X = tracked(watch.samples)
    assert begun_at(X, found, SIXTEEN.agree_m)[0, 3] == pytest.approx(0.0, abs=0.3 * ROCKS_M)
    assert X[found.pictures, 0, 3].mean() == pytest.approx(4.0 * sinks_m_s, rel=0.1)


async def test_a_drive_is_watched_from_rest_to_rest() -> None:
    """The pictures are of before and after the drive; what their halves disagree by is unrest."""
    maps = shipped().local_map
    settings = LocalErrorModelSettings.model_validate(maps.model_dump() | {"at_rest": SIXTEEN.model_dump()})
    seen = {}
    for name, asked in (("one", maps), ("sixteen", settings)):
        rig = SyntheticRig(draw(np.random.default_rng(3), glitch_share=0.0), 3)
        here = (await rig.view()).X_BT
        path = three_legs(here, 0.2)
        seen[name] = await watched_path(rig, rig, path, first_take_up(asked), BOOM, asked)
    assert len(seen["sixteen"].X_BT) >= len(seen["one"].X_BT) + 31
    assert seen["one"].residual_motion == 0.0
    assert 0.0 < seen["sixteen"].residual_motion < 1e-3
    rig = SyntheticRig(draw(np.random.default_rng(3), glitch_share=0.0), 3)
    track = await record_local_track(rig, rig, silent, settings, BOOM)
    assert track.residual_motion > 0.0


def test_a_watch_without_a_pose_is_refused_before_anything_moves() -> None:
    nothing = np.empty((0, 4, 4))
    with pytest.raises(MeasurementFailed) as refused:
        begun_at(nothing, AtRest(slice(0, 0), 0.0), SIXTEEN.agree_m)
    assert refused.value.cause == "measurement.odometry_lost"
