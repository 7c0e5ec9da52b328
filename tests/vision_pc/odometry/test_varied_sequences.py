"""Real sequences with their pictures varied: located as by ORB-SLAM3, refused by name, never wrong."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.support.recorded_drives import Sequence, blurred, dim, eyes, followed, judged, mover
from tests.vision_pc.odometry.test_real_sequences import drift_percent, shown
from vision_pc.config.vision import VisionConfig
from vision_pc.core.types import StereoPair

Variation = Callable[[Sequence], Sequence]
BLACK = range(20, 25)


def part(first: int | None, last: int | None, step: int = 1) -> Variation:
    return lambda given: given.chosen(slice(first, last, step))


def black(k: int, pair: StereoPair) -> StereoPair:
    nothing = np.zeros_like(pair.left)
    return pair._replace(left=nothing, right=nothing) if k in BLACK else pair


def lowered(_: int, pair: StereoPair) -> StereoPair:
    return pair._replace(right=np.roll(pair.right, 3, axis=0))


def exchanged(_: int, pair: StereoPair) -> StereoPair:
    return pair._replace(left=pair.right, right=pair.left)


@pytest.mark.parametrize(
    ("variation", "most_percent"),
    [
        pytest.param(part(None, None), 0.78, id="whole"),
        pytest.param(part(None, None, 2), 0.90, id="every second"),
        pytest.param(part(None, None, 3), 1.20, id="every third"),
        pytest.param(part(0, 12), 1.20, id="its beginning"),
        pytest.param(part(None, None, -1), 0.78, id="backwards"),
        pytest.param(lambda given: given.changed(eyes(blurred)), 0.90, id="blurred"),
        pytest.param(lambda given: given.changed(eyes(dim)), 1.20, id="dim"),
    ],
)
@pytest.mark.slow("drives are followed")
def test_a_drive_is_located_in_one_map(
    config: VisionConfig, variation: Variation, most_percent: float
) -> None:
    drive = variation(shown("drive"))
    result = followed(drive, config)
    found, drift = judged(result, drive), drift_percent(result, drive)
    print(f"{len(drive.pairs) - result.lost} of {len(drive.pairs)}, drift {drift:.2f} %, {found}")
    assert result.lost == 0, result.losses
    assert len(result.joints) == 1
    assert drift < most_percent


@pytest.mark.slow("a drive is followed")
def test_five_black_pairs_cost_themselves_alone(config: VisionConfig) -> None:
    drive = shown("drive").changed(black)
    result = followed(drive, config)
    assert result.losses == {"too_dark": len(BLACK)}
    assert judged(result, drive).worst_sigmas < 3.0


@pytest.mark.parametrize("name", ["drive", "room"])
@pytest.mark.parametrize(("spoil", "cause"), [(lowered, "bad_rectification"), (exchanged, "swapped_eyes")])
@pytest.mark.slow("pictures are looked at")
def test_pairs_that_do_not_fit_are_refused_by_name(
    config: VisionConfig, name: str, spoil: Callable[[int, StereoPair], StereoPair], cause: str
) -> None:
    spoiled = shown(name).chosen(slice(0, 10)).changed(spoil)
    assert followed(spoiled, config).losses == {cause: 10}


@pytest.mark.parametrize("share", [0.3, 0.6])
@pytest.mark.parametrize(("name", "other"), [("drive", "room"), ("room", "drive")])
@pytest.mark.slow("sequences with a thing that moves")
def test_what_moves_is_never_believed(config: VisionConfig, name: str, other: str, share: float) -> None:
    """Lost, or right: places are within 3 σ of the truth in every map."""
    moved = shown(name).changed(mover(share, shown(other).pairs[0].left))
    result = followed(moved, config)
    found = judged(result, moved)
    print(f"{name}, {share}: {len(moved.pairs) - result.lost} of {len(moved.pairs)}, {found}")
    assert found.worst_sigmas < 3.0
