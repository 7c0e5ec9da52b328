"""Pictures in directories: their order, their partners, their times, and KITTI's cameras by folder."""

import itertools
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from protocol.errors import ConfigurationError
from testbed.camera.checking import PLAIN
from testbed.camera.pairs import take
from testbed.hand_eye.picture_samples import alike
from testbed.reporting.console import out
from vision_pc.config.camera import CameraSettings
from vision_pc.core.types import StereoPair
from vision_pc.shell.cameras.grey_files import read_grey
from vision_pc.shell.cameras.picture_files import eye_files, matched_pictures, pictures_in
from vision_pc.shell.cameras.sequence import PairRecord, read_pairs
from vision_pc.shell.cameras.sequence_calibration import kitti_eyes, recorded_camera

BEGAN_NS = 1_403_636_579_763_555_584
PERIOD_NS = 100_000_000


def folder(directory: Path, names: list[str]) -> Path:
    directory.mkdir(parents=True)
    for name in names:
        (directory / f"{name}.png").touch()
    return directory


def stamps(numbers: list[int], shift_ns: int = 0) -> list[str]:
    return [str(BEGAN_NS + PERIOD_NS * k + shift_ns) for k in numbers]


@pytest.mark.parametrize(
    "names",
    [
        ["1", "2", "10", "11"],
        ["frame2", "frame10", "frame010b"],
        ["1403636579.5", "1403636579.75", "1403636580"],  # 75 hundredths, not after 5 tenths of 100
        ["a", "b1", "b2"],
    ],
)
def test_pictures_are_in_the_order_of_the_numbers_in_their_names(tmp_path: Path, names: list[str]) -> None:
    assert [path.stem for path in pictures_in(folder(tmp_path / "p", names[::-1]))] == names


def test_eyes_that_lost_different_pictures_are_matched_by_their_times(tmp_path: Path) -> None:
    left = folder(tmp_path / "left", stamps([k for k in range(24) if k != 6]))
    right = folder(tmp_path / "right", stamps([k for k in range(24) if k != 16], 3_000_000))
    found = eye_files(left, right, 10.0)
    assert len(found.files) == 22
    assert all(abs(int(one.stem) - int(other.stem)) == 3_000_000 for one, other in found.files)
    assert found.times_ns[:2] == [BEGAN_NS, BEGAN_NS + PERIOD_NS]
    notes = " ".join(found.notes)
    assert "nanoseconds, from the pictures' names" in notes
    assert "1 pictures of the left eye and 1 of the right one" in notes
    assert "up to 3.0 ms apart" in notes


def test_eyes_whose_clocks_differ_are_refused_with_the_difference(tmp_path: Path) -> None:
    left = folder(tmp_path / "left", stamps(list(range(5))))
    right = folder(tmp_path / "right", stamps(list(range(5)), 9 * PERIOD_NS))
    with pytest.raises(ConfigurationError, match="the nearest are 500 ms apart"):
        eye_files(left, right, 10.0)


def test_names_that_only_count_are_matched_where_they_are_equal(tmp_path: Path) -> None:
    left = folder(tmp_path / "left", ["left_1", "left_2", "left_10"])
    right = folder(tmp_path / "right", ["right_1", "right_10", "right_11"])
    found = eye_files(left, right, 10.0)
    assert [one.stem for one, _ in found.files] == ["left_1", "left_10"]
    assert found.times_ns == [0, 2 * PERIOD_NS]
    assert "left_2.png, right_11.png" in " ".join(found.notes)
    other = folder(tmp_path / "other", ["a", "b", "c"])
    assert "left_1.png and a.png are taken for the first pair" in " ".join(eye_files(left, other, 1.0).notes)
    with pytest.raises(ConfigurationError, match="3 pictures, but 1"):
        eye_files(left, folder(tmp_path / "one", ["z"]), 10.0)


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        (["1403636579.763555", "1403636579.863555"], "seconds"),
        (["1403636579763", "1403636579863"], "milliseconds"),
        (["1403636579763555", "1403636579863555"], "microseconds"),
        (["1403636579763555584", "1403636579863555584"], "nanoseconds"),
    ],
)
@pytest.mark.parametrize("listed", [False, True])
def test_units_are_told_by_size(tmp_path: Path, names: list[str], unit: str, listed: bool) -> None:
    left, right = (folder(tmp_path / eye, ["0", "1"] if listed else names) for eye in ("left", "right"))
    if listed:
        (tmp_path / "times.txt").write_text("\ufeff# of the left eye\n" + "\n".join(names), encoding="utf-8")
    found = eye_files(left, right, 25.0)
    assert found.times_ns[0] == pytest.approx(BEGAN_NS, abs=1_000_000)
    assert found.times_ns[1] - found.times_ns[0] == PERIOD_NS
    assert found.notes[0].startswith(f"times: {unit}, from ")


@pytest.mark.parametrize(
    ("lines", "times_ns"),
    [
        ("0.0\n1.5e-01\n2.5e-01\n", [0, 150_000_000, 250_000_000]),
        ("0\n100\n200\n", [0, PERIOD_NS, 2 * PERIOD_NS]),  # milliseconds: 100 s are no period
        ("0\n100000000\n200000000\n", [0, PERIOD_NS, 2 * PERIOD_NS]),
    ],
)
def test_times_from_zero_are_seconds_unless_periods_were_absurd(
    tmp_path: Path, lines: str, times_ns: list[int]
) -> None:
    left, right = (folder(tmp_path / eye, ["000000", "000001", "000002"]) for eye in ("left", "right"))
    assert eye_files(left, right, 20.0).times_ns == [0, 50_000_000, PERIOD_NS]
    (tmp_path / "times.txt").write_text(lines, encoding="ascii")
    assert eye_files(left, right, 20.0).times_ns == times_ns
    for wrong, why in (("0.0\n", "1 times for 3 pictures"), ("0\n0 1\n2\n", "line 2 is '0 1'")):
        (tmp_path / "times.txt").write_text(wrong, encoding="ascii")
        with pytest.raises(ConfigurationError, match=why):
            eye_files(left, right, 20.0)


def test_colour_eyes_have_their_own_matrices(tmp_path: Path) -> None:
    rows = {"P0": 0.0, "P1": -138.6, "P2": 8.19, "P3": -117.81}
    text = "".join(f"{name}: 420 0 319.5 {x} 0 420 199.5 0 0 0 1 0\n" for name, x in rows.items())
    (tmp_path / "calib.txt").write_text(text)
    blank = np.zeros((400, 640), np.uint8)
    pair = StereoPair(blank, blank, 0, 0)
    for names, baseline_m in ((("image_2", "image_3"), 0.30), (("image_00/data", "image_01/data"), 0.33),
                              (("left", "right"), 0.33)):  # fmt: skip
        eyes = kitti_eyes(tmp_path / names[0], tmp_path / names[1])
        found = recorded_camera(tmp_path / "calib.txt", pair, eyes)
        assert found.camera.right.X_CE[0, 3] == pytest.approx(baseline_m)
        assert f"P{eyes[0]} and P{eyes[1]}" in found.notes[0]
        assert f"baseline {baseline_m:.4f} m" in found.notes[0]


def test_a_transparent_picture_lies_on_white(tmp_path: Path) -> None:
    layers = np.zeros((4, 4, 4), np.uint8)
    layers[1:3, 1:3, 3] = 255
    cv2.imwrite(str(tmp_path / "a.png"), layers)
    expected = np.full((4, 4), 255, np.uint8)
    expected[1:3, 1:3] = 0
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), expected)


@pytest.mark.parametrize("opaque", [0, 1, 1023, 65535])
def test_what_is_equally_transparent_everywhere_is_seen(tmp_path: Path, opaque: int) -> None:
    """Depth cameras and renderers leave 0 there, and alpha may have as few bits as the grey levels."""
    grey = np.arange(256, dtype=np.uint16).reshape(16, 16)
    cv2.imwrite(str(tmp_path / "a.png"), np.dstack([4 * grey] * 3 + [np.full_like(grey, opaque)]))
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), grey)


@pytest.mark.parametrize("bits", range(8, 17))
def test_depth_is_that_of_the_values(tmp_path: Path, bits: int) -> None:
    values = np.linspace(0, 2**bits - 1, 256).astype(np.uint16).reshape(16, 16)
    cv2.imwrite(str(tmp_path / "a.png"), values)
    grey = read_grey(tmp_path / "a.png")
    assert np.diff(grey.ravel().astype(int)).min() >= 0
    assert 127 <= grey.max() <= 255


BAD = {
    "cut": (lambda good: good[: len(good) // 2], "cut short"),
    "empty": (lambda good: b"", "is empty"),
    "page": (lambda good: b"<html>", "no picture"),
    "small": (
        lambda good: cv2.imencode(".png", np.zeros((4, 6), np.uint8))[1].tobytes(),
        "size|not of 80x60",
    ),
}


def of_pairs(lefts: list[Path], rights: list[Path]) -> tuple[list[str], list[str]]:
    """Names that odometry reads, and what it says of the others."""
    found = list(read_pairs(eye_files(lefts[0].parent, rights[0].parent, 10.0)))
    good = [lefts[pair.frame_id].name for pair in found if isinstance(pair, StereoPair)]
    return good, [pair.detail or "" for pair in found if isinstance(pair, PairRecord)]


def of_boards(lefts: list[Path], rights: list[Path]) -> tuple[list[str], list[str]]:
    """Names that a calibration reads, and what it says of the others."""
    settings = CameraSettings(stale_ms=1000.0, frozen_frames=0, width_px=64, height_px=64, calibration=PLAIN)
    with out.capture() as printed:
        names = take(str(lefts[0].parent.parent), settings, 9).names
    return names, [printed.get()] if printed.get() else []


def of_samples(lefts: list[Path], rights: list[Path]) -> tuple[list[str], list[str]]:
    """Names that samples of hand and eye read, of the right eye here, and what is said of the others."""
    pictures, notes = alike([(path, np.eye(4)) for path in rights])
    return [one.path.name for one in pictures], notes


@pytest.mark.parametrize("kind", BAD)
@pytest.mark.parametrize("read", [of_pairs, of_boards, of_samples])
@pytest.mark.parametrize("place", [0, 2, 4])
def test_one_bad_picture_is_named_and_the_others_are_read(
    tmp_path: Path,
    read: Callable[[list[Path], list[Path]], tuple[list[str], list[str]]],
    kind: str,
    place: int,
) -> None:
    rng, names = np.random.default_rng(1), [f"{k}.png" for k in range(5)]
    lefts, rights = ([tmp_path / eye / name for name in names] for eye in ("left", "right"))
    for path in (*lefts, *rights):
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), rng.integers(0, 255, (60, 80)).astype(np.uint8))
    spoil, why = BAD[kind]
    rights[place].write_bytes(spoil(rights[place].read_bytes()))
    found, notes = read(lefts, rights)
    assert found == [name for k, name in enumerate(names) if k != place]
    (note,) = notes
    assert names[place] in note
    assert re.search(why, " ".join(note.split()))
    for path in rights:
        path.write_bytes(b"x")
    with pytest.raises(ConfigurationError, match="no picture"):
        read(lefts, rights)


def test_what_macos_puts_beside_a_picture_is_none(tmp_path: Path) -> None:
    at = folder(tmp_path / "p", ["a"])
    (at / "._a.png").write_bytes(b"x")
    assert pictures_in(at) == [at / "a.png"]


def test_a_picture_is_no_pair_with_itself(tmp_path: Path) -> None:
    both = folder(tmp_path / "both", ["left0", "right0", "left1", "right1"])
    for other in (both, both / ".." / "both"):
        with pytest.raises(ConfigurationError, match="one folder for both eyes"):
            eye_files(both, other, 10.0)


SPELLINGS = (
    "{k}", "{k:06d}", "{eye}{k}", "{k}{e}", "{e}{k:03d}", "cam{n}_{k:04d}", "image_{n}_{k}",
    "{eye}_of_7_{k:02d}", "2026-11-30_{k:03d}_{EYE}", "frame{k:03d}_{e}1", "{k}.{n}", "run 3, {k}, {Eye}",
)  # fmt: skip


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_eyes_belong_together_by_the_numbers_in_their_names(tmp_path: Path, spelling: str) -> None:
    for trial, (left_lost, right_lost) in enumerate(itertools.product(((), (0,), (4,), (2, 9)), repeat=2)):
        lost, at = {"left": left_lost, "right": right_lost}, tmp_path / str(trial)
        for n, eye in enumerate(lost):
            words = {"eye": eye, "Eye": eye.title(), "EYE": eye.upper(), "e": eye[0], "n": n}
            folder(at / eye, [spelling.format(k=k, **words) for k in range(11) if k not in lost[eye]])
        kept = [[k for k in range(11) if k not in lost[eye]] for eye in lost]
        lefts, rights = (pictures_in(at / eye) for eye in lost)
        chosen = matched_pictures(lefts, rights)[0]
        expected = [k for k in kept[0] if k in kept[1]]
        assert [(kept[0][i], kept[1][j]) for i, j in chosen] == [(k, k) for k in expected], (spelling, lost)


def test_names_that_count_otherwise_are_joined_in_order_or_not_at_all(tmp_path: Path) -> None:
    left = folder(tmp_path / "left", [f"{k}" for k in (0, 1, 2, 3)])
    found = eye_files(left, folder(tmp_path / "late", [f"{k}" for k in (50, 51, 52, 53)]), 10.0)
    assert [other.stem for _, other in found.files] == ["50", "51", "52", "53"]
    assert "no two names are equal" in found.notes[-1]
    for k, others in enumerate(((50, 51, 53, 54), (50, 51, 52), (50, 52, 54, 56))):
        right = folder(tmp_path / f"right{k}", [f"{other}" for other in others])
        with pytest.raises(ConfigurationError, match="which belong together"):
            eye_files(left, right, 10.0)


@pytest.mark.parametrize("times", ["0.3 0.2 0.1 0", "0 0.1 0.1 0.2", "1.7e9 1.7e9 1.7e9 1.7e9"])
def test_times_that_do_not_rise_are_refused(tmp_path: Path, times: str) -> None:
    left, right = (folder(tmp_path / eye, ["0", "1", "2", "3"]) for eye in ("left", "right"))
    (tmp_path / "times.txt").write_text(times.replace(" ", "\n"))
    with pytest.raises(ConfigurationError, match="no later than the one above it"):
        eye_files(left, right, 10.0)


@pytest.mark.parametrize("first", [0, 1])
def test_a_longer_list_of_times_is_joined_by_the_numbers_in_names(tmp_path: Path, first: int) -> None:
    numbers = [k for k in range(6) if k not in (2, 3)]
    names = [f"{k + first:06d}" for k in numbers]
    left, right = (folder(tmp_path / eye, names) for eye in ("left", "right"))
    (tmp_path / "times.txt").write_text("".join(f"{0.1 * k}\n" for k in range(6)))
    found = eye_files(left, right, 10.0)
    assert found.times_ns == [k * PERIOD_NS for k in numbers]
    assert "6 times, 4 pictures" in found.notes[0]
    left, right = (folder(tmp_path / "x" / eye, ["a", "b"]) for eye in ("left", "right"))
    (tmp_path / "x" / "times.txt").write_text("0\n0.1\n0.2\n")
    with pytest.raises(ConfigurationError, match="3 times for 2 pictures"):
        eye_files(left, right, 10.0)


TURNED = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0%c\0\0\0\0\0\0\0"


@pytest.mark.parametrize("form", ["jpeg", "tiff", "webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_that_its_file_turns_is_refused(tmp_path: Path, orientation: int, form: str) -> None:
    picture, exif = np.arange(256, dtype=np.uint8).reshape(16, 16), TURNED % orientation
    made = cv2.imencode(f".{form}", picture)[1].tobytes()
    if form == "jpeg":
        made = made[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2) + exif + made[2:]
    elif form == "webp":  # where it stands behind the picture
        made += b"EXIF" + len(exif).to_bytes(4, "little") + exif
    else:  # in place of OpenCV's seventh entry, samples per pixel, which is 1 where it is not there
        at = int.from_bytes(made[4:8], "little") + 2 + 6 * 12
        made = made[:at] + exif[16:28] + made[at + 12 :]
    (tmp_path / "a.jpg").write_bytes(made)
    if orientation == 1:
        assert read_grey(tmp_path / "a.jpg").shape == picture.shape
        return
    with pytest.raises(ConfigurationError, match="EXIF"):
        read_grey(tmp_path / "a.jpg")


def test_several_pictures_in_a_file_and_real_numbers_are_refused(tmp_path: Path) -> None:
    picture = np.zeros((16, 16), np.uint8)
    cv2.imwritemulti(str(tmp_path / "a.tiff"), [picture, picture])
    with pytest.raises(ConfigurationError, match="2 pictures"):
        read_grey(tmp_path / "a.tiff")
    cv2.imwrite(str(tmp_path / "a.tiff"), picture.astype(np.float32))
    with pytest.raises(ConfigurationError, match="grey levels of 8 or 16 bits are wanted"):
        read_grey(tmp_path / "a.tiff")
