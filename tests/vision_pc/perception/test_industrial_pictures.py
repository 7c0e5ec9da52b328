"""Pictures of industrial cameras: pixel formats taken apart by hand, and which two are of one moment."""

from collections.abc import Iterable

import numpy as np
import pytest

from protocol.errors import FrameRefused
from vision_pc.config.camera import GenicamSettings
from vision_pc.core.perception.pair_matching import EyePicture, PairMatcher
from vision_pc.core.perception.pixel_formats import grey_levels
from vision_pc.core.types import StereoPair

MS = 1_000_000
PERIOD_NS = 100 * MS


def test_grey_of_eight_ten_and_twelve_bits_keeps_the_upper_eight() -> None:
    values = np.array([0, 4, 512, 1023, 700, 3, 255, 256], dtype=np.uint16)
    upper = (values >> 2).astype(np.uint8).reshape(2, 4)
    packed = sum(int(value) << 10 * place for place, value in enumerate(values)).to_bytes(10, "little")
    assert (grey_levels(packed, 4, 2, 0x010A0046, "a") == upper).all()
    assert (grey_levels(values.astype("<u2").tobytes(), 4, 2, 0x01100003, "a") == upper).all()
    assert (grey_levels((values << 2).astype("<u2").tobytes(), 4, 2, 0x01100005, "a") == upper).all()
    assert (grey_levels(upper.tobytes(), 4, 2, 0x01080001, "a") == upper).all()


@pytest.mark.parametrize(
    ("code", "red"), [(0x01080009, (0, 0)), (0x01080008, (0, 1)), (0x0108000A, (1, 0)), (0x0108000B, (1, 1))]
)
def test_a_mosaic_of_a_red_scene_is_as_dark_as_red_is(code: int, red: tuple[int, int]) -> None:
    picture = np.zeros((16, 16), dtype=np.uint8)
    picture[red[0] :: 2, red[1] :: 2] = 200
    grey = grey_levels(picture.tobytes(), 16, 16, code, "a")[4:-4, 4:-4]
    assert grey.mean() == pytest.approx(0.299 * 200, abs=2.0)  # of blue it would be 0.114


def test_pixels_that_are_not_known_or_lack_are_refused_by_name() -> None:
    with pytest.raises(FrameRefused, match="0x02180014"):
        grey_levels(bytes(12), 2, 2, 0x02180014, "camera 10.0.0.1")
    with pytest.raises(FrameRefused, match=r"camera 10\.0\.0\.1: 3 bytes came, 4"):
        grey_levels(bytes(3), 2, 2, 0x01080001, "camera 10.0.0.1")


def eyes(
    left_ns: Iterable[int], right_ns: Iterable[int], clocks_apart_ns: int = 0
) -> list[tuple[int, EyePicture]]:
    """Pictures of both, in the order of their times; each holds the number of its moment."""
    made = []
    for eye, times in enumerate((left_ns, right_ns)):
        for number, at_ns in enumerate(times):
            picture = np.full((2, 2), number % 256, dtype=np.uint8)
            made.append((at_ns, eye, EyePicture(at_ns + eye * clocks_apart_ns, at_ns, picture)))
    return [(eye, picture) for _, eye, picture in sorted(made, key=lambda each: each[:2])]


def matched(matcher: PairMatcher, pictures: list[tuple[int, EyePicture]]) -> list[StereoPair]:
    return [pair for eye, picture in pictures if (pair := matcher.add(eye, picture)) is not None]


@pytest.mark.parametrize("common", [True, False])
@pytest.mark.parametrize("clocks_apart_ns", [0, 37 * 10**12 + 12_345])
def test_pictures_of_one_trigger_are_pairs_whatever_is_lost(common: bool, clocks_apart_ns: int) -> None:
    if common and clocks_apart_ns:
        pytest.skip("one clock has no difference")
    drawn = np.random.default_rng(4)
    moments = [k * PERIOD_NS for k in range(200)]
    pictures = [each for each in eyes(moments, moments, clocks_apart_ns) if drawn.random() > 0.15]
    matcher = PairMatcher(MS, common_clock=common)
    pairs = matched(matcher, pictures)
    assert all((pair.left == pair.right).all() for pair in pairs)
    both = sum(1 for _, p in pictures) - 2 * len(pairs)
    assert len(pairs) > 130
    assert matcher.unpaired >= both - 2
    assert [pair.frame_id for pair in pairs] == list(range(1, len(pairs) + 1))


@pytest.mark.parametrize("common", [True, False])
def test_cameras_that_run_freely_are_refused_by_name(common: bool) -> None:
    left = [k * PERIOD_NS for k in range(100)]
    right = [round(k * 1.013 * PERIOD_NS) + 20 * MS for k in range(100)]
    with pytest.raises(FrameRefused, match="trigger both cameras by one line") as refused:
        matched(PairMatcher(MS, common_clock=common), eyes(left, right))
    assert refused.value.cause == "measurement.camera.unpaired"


def test_two_eyes_are_two_cameras() -> None:
    with pytest.raises(ValueError, match="each eye is a camera of its own"):
        GenicamSettings(left="10.0.0.1", right="10.0.0.1")


def test_a_picture_shown_again_and_a_clock_that_begins_anew_make_no_false_pair() -> None:
    moments = [k * PERIOD_NS for k in range(20)]
    matcher = PairMatcher(MS, common_clock=True)
    twice = [each for one in eyes(moments, moments) for each in (one, one)]
    assert len(matched(matcher, twice)) == 20
    again = eyes([10**15 + t for t in moments], [10**15 + t for t in moments])
    assert all((pair.left == pair.right).all() for pair in matched(matcher, again))
