"""Calibrations and poses of others with every mistake that a generator makes: right, or refused by name.

Each good file is made wrong at every place in every way. What is then read is either the camera, or the
poses, of the good file, or a refusal with a cause: nothing else, and no traceback.
"""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from protocol.errors import LongreachError
from testbed.choices import PoseForm
from testbed.hand_eye.pose_text import read_robot_poses
from testbed.hand_eye.trajectories import load_tum
from tests.vision_pc.config import test_camera_files as cameras
from vision_pc.config.camera_files.reading import read_calibrations
from vision_pc.config.stereo_camera import StereoCalibration
from vision_pc.core.se3 import Array
from vision_pc.core.types import StereoPair
from vision_pc.shell.cameras.sequence_calibration import recorded_camera

pytestmark = pytest.mark.slow("ten thousand files")
Mistake = tuple[str, str]
"""What was done, and the file's text then."""
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
NO_NUMBERS = ("nan", ".nan", "inf", "0x10", "5,0",
              "\uff15.0", "true", "1_0", "1e", "--1", "1:30", "''", "[1]", "1'000")  # fmt: skip


def in_numbers(text: str) -> Iterator[Mistake]:
    """Every number written as none, and otherwise but as the same."""
    for found in NUMBER.finditer(text):
        head, tail, value = text[: found.start()], text[found.end() :], float(found[0])
        for word in NO_NUMBERS:
            yield f"{found[0]} at {found.start()} is {word}", head + word + tail
        yield f"{found[0]} as %e", f"{head}{value:.17e}{tail}"
        yield f"{found[0]} with U+2212", head + found[0].replace("-", "\u2212") + tail


def in_lists(text: str) -> Iterator[Mistake]:
    """Every list with one item too many, too few, twice."""
    for found in re.finditer(r"\[([^\[\]]*,[^\[\]]*)\]", text):
        items, head, tail = found[1].split(","), text[: found.start()], text[found.end() :]
        wrong = {"too many": [*items, " 0.5"], "too few": items[:-1], "twice": [items[0], *items]}
        for what, list_ in wrong.items():
            yield f"{found[0][:20]} {what}", f"{head}[{','.join(list_)}]{tail}"


def in_lines(text: str) -> Iterator[Mistake]:
    """Every line left out, twice, and the file cut in each."""
    lines = text.splitlines(keepends=True)
    for k, line in enumerate(lines):
        yield f"without {line[:30]!r}", "".join(lines[:k] + lines[k + 1 :])
        yield f"{line[:30]!r} twice", "".join([*lines[: k + 1], line, *lines[k + 1 :]])
        yield f"cut in {line[:30]!r}", "".join(lines[:k]) + line[: len(line) // 2]


def in_words(text: str) -> Iterator[Mistake]:
    """Other sizes, lens models and units."""
    width, height = cameras.SIZE
    for by in (0.25, 0.5, 1.5, 2.0):
        other = re.sub(rf"\b{width}\b", f"{by * width:g}", re.sub(rf"\b{height}\b", f"{by * height:g}", text))
        yield f"size times {by}", other
    yield (
        "width and height exchanged",
        (text.replace(str(width), "WIDTH").replace(str(height), str(width)).replace("WIDTH", str(height))),
    )
    yield "half a pixel", re.sub(rf"\b{width}\b", f"{width}.5", text)
    for model in ("radtan", "plumb_bob", "PinHole", "pinhole"):
        yield f"{model} as plumb-bob", re.sub(rf"\b{model}\b", "plumb-bob", text)
    for key in ("Baseline=119.9", "-0.1199"):
        for by in (1e3, 1e-3):
            value = NUMBER.search(key.rpartition("=")[2])
            assert value is not None
            yield f"{key} times {by}", text.replace(value[0], f"{by * float(value[0]):.9g}")


def orb_eye(eye: int, K: Array, D: tuple[float, ...]) -> str:
    """One eye in ORB-SLAM3's settings."""
    places = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    values = {**places, **dict(zip(("k1", "k2", "p1", "p2", "k3"), D, strict=True))}
    return "".join(f"Camera{eye}.{key}: {float(value)!r}\n" for key, value in values.items())


X_LR = np.linalg.inv(np.vstack([np.column_stack([cameras.R, cameras.T]), [0.0, 0.0, 0.0, 1.0]]))
ORB = (
    '%YAML:1.0\nCamera.type: "PinHole"\nCamera.width: 1280\nCamera.height: 720\n'
    + orb_eye(1, cameras.K1, cameras.D1)
    + orb_eye(2, cameras.K2, cameras.D2)
    + f"Stereo.T_c1_c2: !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: d\n   data: {X_LR.ravel().tolist()}\n"
)


def good_calibrations(at: Path) -> dict[str, list[Path]]:
    """The files of one camera in each form."""
    left, right = cameras.camera_infos()
    stored = {"M1": cameras.K1, "D1": np.array([cameras.D1]), "M2": cameras.K2, "D2": np.array([cameras.D2])}
    stored |= {"R": cameras.R, "T": cameras.T}
    sized = "\nimage_width: 1280\nimage_height: 720\n"
    yaml, xml = (cameras.storage(at / name, 1.0, **stored) for name in ("cv.yml", "cv.xml"))
    yaml.write_text(yaml.read_text("utf-8") + sized, "utf-8")
    sizes = "<image_width>1280</image_width>\n<image_height>720</image_height>\n</opencv_storage>"
    xml.write_text(xml.read_text("utf-8").replace("</opencv_storage>", sizes), "utf-8")
    return {
        "zed": [cameras.write(at / "SN1.conf", cameras.ZED)],
        "kalibr": [cameras.write(at / "chain.yaml", cameras.camchain())],
        "ros": [cameras.write(at / "right.yaml", right), cameras.write(at / "left.yaml", left)][::-1],
        "opencv": [yaml],
        "xml": [xml],
        "orb": [cameras.write(at / "orb.yaml", ORB)],
    }


def trouble(words: str, read: Callable[[], str]) -> str:
    """Why what came of a mistake is not right; empty where it is."""
    try:
        what = read()
    except LongreachError as error:
        return "" if error.cause and "\n" not in str(error) else f"{words}: {error!r}"
    except Exception as error:  # any other is a fault of the reader
        return f"{words}: {type(error).__name__}: {error}"
    return what and f"{words}: {what}"


def figures(camera: StereoCalibration) -> Array:
    """All numbers of a camera."""
    eyes = [[*e.distortion, e.fx_px, e.fy_px, e.cx_px, e.cy_px] for e in (camera.left, camera.right)]
    place = [*camera.right_position_m, *camera.right_rotation_vector_deg]
    return np.array([camera.width_px, camera.height_px, *eyes[0], *eyes[1], *place])


@pytest.mark.parametrize("form", ["zed", "kalibr", "ros", "opencv", "xml", "orb"])
def test_calibrations_written_otherwise(form: str, tmp_path: Path) -> None:
    files = good_calibrations(tmp_path)[form]
    size = cameras.SIZE if form == "zed" else None
    camera = read_calibrations(files, size)
    good = files[0].read_text("utf-8")

    def read() -> str:
        found = read_calibrations(files, size)
        parts = {"source": "", "covariance": None}
        same = np.allclose(figures(found), figures(camera), rtol=1e-12, atol=1e-12)
        return "" if same else f"read as {found.model_copy(update=parts)!r}"[:300]

    wrong, count = [], 0
    for make in (in_numbers, in_lists, in_lines, in_words):
        for words, text in make(good):
            count += 1
            files[0].write_text(text, "utf-8")
            why = trouble(words, read)
            wrong += [why] if why else []
    files[0].write_text(good, "utf-8")
    if len(files) == 2:
        files.reverse()
        wrong += [why for why in [trouble("eyes exchanged", read)] if why]
    print(f"{form}: {count} files, {len(wrong)} wrong")
    assert not wrong, "\n".join(wrong[:20])


@pytest.mark.parametrize(("by_x", "by_y"), [(2, 2), (4, 2), (1, 4)])
@pytest.mark.parametrize("window", [None, (160, 90, 960, 540)])
def test_windows_and_binnings_of_camera_info(
    by_x: int, by_y: int, window: tuple[int, int, int, int] | None, tmp_path: Path
) -> None:
    x, y, width, height = window or (0, 0, 0, 0)
    roi = f"roi: {{x_offset: {x}, y_offset: {y}, width: {width}, height: {height}, do_rectify: false}}\n"
    files = [cameras.write(tmp_path / f"{k}.yaml", f"{text}binning_x: {by_x}\nbinning_y: {by_y}\n{roi}")
             for k, text in enumerate(cameras.camera_infos())]  # fmt: skip
    found = read_calibrations(files)
    assert (found.width_px, found.height_px) == ((width or 1280) // by_x, (height or 720) // by_y)
    eye, K = found.left, cameras.K1
    expected = (K[0, 0] / by_x, K[1, 1] / by_y, (K[0, 2] - x) / by_x, (K[1, 2] - y) / by_y)
    np.testing.assert_allclose((eye.fx_px, eye.fy_px, eye.cx_px, eye.cy_px), expected)
    good = files[0].read_text("utf-8").removesuffix(roi)
    for wrong in ("x_offset: 700, width: 960", "width: 1281", "x_offset: -1", "width: true", "height: 1.5e9"):
        cameras.write(files[0], f"{good}roi: {{{wrong}}}\n")
        with pytest.raises(LongreachError, match=r"roi\.(x_offset|width|height|y_offset)"):
            read_calibrations(files)


KITTI = "P0: 420 0 319.5 0 0 421 199.5 0 0 0 1 0\nP1: 420 0 319.5 -126 0 421 199.5 0 0 0 1 0\n"


def test_kittis_matrices_written_otherwise(tmp_path: Path) -> None:
    path, blank = tmp_path / "calib.txt", np.zeros((400, 640), np.uint8)
    pair = StereoPair(blank, blank, 0, 0)

    def read() -> str:
        camera = recorded_camera(path, pair).camera
        same = np.allclose(
            camera.left.K, np.array([[420.0, 0.0, 319.5], [0.0, 421.0, 199.5], [0.0, 0.0, 1.0]])
        )
        return "" if same and np.isclose(camera.right.X_CE[0, 3], 0.3) else "read as another camera"

    for good in (KITTI, KITTI.replace("P", "P_rect_0")):  # the second as in KITTI's raw data
        cameras.write(path, good)
        assert read() == ""
    for other, told in (("-126 0 421 189.5", r"P1's cy = 189\.5: 199\.5"), ("-126 9 421 199.5", "in rows")):
        cameras.write(path, KITTI.replace("-126 0 421 199.5", other))
        with pytest.raises(LongreachError, match=told):
            read()
    units = [(f"P1[3] {word}", KITTI.replace("-126", word)) for word in ("-0.3", "126", "0", "-126000")]
    mistakes = [*in_numbers(KITTI), *in_lines(KITTI), *units]
    wrong = []
    for words, text in mistakes:
        cameras.write(path, text)
        why = trouble(words, read)
        wrong += [why] if why else []
    print(f"kitti: {len(mistakes)} files, {len(wrong)} wrong")
    assert not wrong, "\n".join(wrong[:20])


def poses() -> Array:
    """Five poses (n, 7) x y z qx qy qz qw, and no two numbers alike."""
    rng = np.random.default_rng(6)
    return np.column_stack([rng.normal(size=(5, 3)), Rotation.random(5, rng=rng).as_quat()])


def written_poses() -> Iterator[tuple[str, str]]:
    """Good trajectories as programs write them."""
    rows = np.column_stack([1.7e9 + 0.1 * np.arange(5), poses()])
    swapped = rows[:, [0, 1, 2, 3, 7, 4, 5, 6]]
    names = ["timestamp", "x", "y", "z", "qx", "qy", "qz", "qw"]
    for between in (" ", "\t", ", ", ",", ";", "; "):
        for heading in ("", "# ", "plain"):
            for minus in ("-", "\u2212"):
                for ends in ("\n", "\r\n"):
                    head = heading and heading.replace("plain", "") + between.join(names) + ends
                    lines = [between.join(f"{v:.9f}" for v in row).replace("-", minus) for row in rows]
                    yield f"{between!r} {heading!r} {minus} {ends!r}", head + ends.join(lines) + ends
        head = between.join([*names[:4], "qw", "qx", "qy", "qz"])
        lines = [between.join(f"{v:.9f}" for v in row) for row in swapped]
        yield f"{between!r}, w first", "\n".join([head, *lines, ""])
        columns = ["t", "rot_w", "rot_x", "rot_y", "rot_z", "p_x", "p_y", "p_z"]
        lines = [between.join(f"{v:.9f}" for v in row) for row in rows[:, [0, 7, 4, 5, 6, 1, 2, 3]]]
        yield f"{between!r}, rotation first", "\n".join([between.join(columns), *lines, ""])
    for x in ("x_mm", "x [mm]", "pos_x(mm)"):
        head = ",".join(["t", *(x.replace("x", axis, 1) for axis in "xyz"), "q.x", "q.y", "q.z", "q.w"])
        lines = [",".join(f"{v:.9f}" for v in row) for row in rows * [1, 1e3, 1e3, 1e3, 1, 1, 1, 1]]
        yield x, "\n".join([head, *lines])
    for words, between in (("commas, blanks", "  "), ("decimal commas", ";")):
        yield words, "\n".join(between.join(f"{v:.9f}".replace(".", ",") for v in row) for row in rows)
    for words, first, between, last in (("quoted", '"', '","', '"'), ("remarks", "# so\n", " ", " # so")):
        yield words, "\n".join(first + between.join(f"{v:.9f}" for v in row) + last for row in rows)
    euroc = np.column_stack([swapped, np.zeros((5, 9))])
    yield "EuRoC", "\n".join(",".join(f"{v:.9f}" for v in row) for row in euroc)


def test_poses_written_otherwise(tmp_path: Path) -> None:
    path, true = tmp_path / "poses.tum", poses()
    R = Rotation.from_quat(true[:, 3:]).as_matrix()

    def read() -> str:
        X = load_tum(path).X
        same = len(X) == 5 and np.allclose(X[:, :3, 3], true[:, :3], atol=1e-8)
        same = same and np.allclose(X[:, :3, :3], R, atol=1e-7)
        return "" if same else f"read as {X[:, :3, 3].tolist()}"

    wrong, count = [], 0
    for k, (words, text) in enumerate(written_poses()):
        count += 1
        path.write_text(text, "utf-8")
        wrong += [f"{words}: {why}"] if (why := read()) else []
        for what, bad in (*in_numbers(text), *in_lines(text)) if k % 9 == 0 else ():
            if what.endswith("is [1]"):
                continue  # brackets are a way of writing poses
            count += 1
            path.write_text(bad, "utf-8")
            why = trouble(f"{words}: {what}", read)
            if why and not re.search(r": (without|cut in) ", why):  # a pose fewer is a shorter recording
                wrong.append(why)
    print(f"poses: {count} files, {len(wrong)} wrong")
    assert not wrong, "\n".join(wrong[:20])


def test_kittis_poses_written_otherwise(tmp_path: Path) -> None:
    path, true, times_s = tmp_path / "00.txt", poses(), 0.1 * np.arange(5)
    upper = np.dstack([Rotation.from_quat(true[:, 3:]).as_matrix(), true[:, :3]])
    good = "".join(" ".join(f"{v:.9e}" for v in row.ravel()) + "\n" for row in upper)

    def read() -> str:
        found = load_tum(path, times_s=times_s)
        same = np.allclose(found.X[:, :3], upper, atol=1e-8) and np.array_equal(found.time_s, times_s)
        return "" if same else f"read as {found.X[:, :3, 3].tolist()}"

    mistakes = [("as it is", good), *in_numbers(good), *in_lines(good)]
    exchanged = np.dstack([upper[..., [1, 0, 2]], true[:, :3]])
    others = (exchanged, 2.0 * upper, upper.reshape(5, 12)[:, :11])
    mistakes += [
        ("other", "".join(" ".join(f"{v:.9e}" for v in row.ravel()) + "\n" for row in rows))
        for rows in others
    ]
    wrong = []
    for words, text in mistakes:
        path.write_text(text, "utf-8")
        why = "" if words.endswith("is [1]") else trouble(words, read)  # brackets are a way of writing poses
        wrong += [why] if why else []
    print(f"kitti's poses: {len(mistakes)} files, {len(wrong)} wrong")
    assert not wrong, "\n".join(wrong[:20])
    path.write_text(good, "utf-8")
    for none in (None, times_s[:4], np.append(times_s, 0.5)):
        with pytest.raises(LongreachError, match="5 poses of 12 columns"):
            load_tum(path, times_s=none)


KUKA = "X {}, Y {}, Z {}, A {}, B {}, C {}"
ABB = "[[{}, {}, {}], [{}, {}, {}, {}], [0, -1, 0, 0], [9E+09, 9E+09, 9E+09, 9E+09, 9E+09, 9E+09]]"


@pytest.mark.parametrize(
    ("form", "line"),
    [(PoseForm.UR, "p[{}, {}, {}, {}, {}, {}]"), (PoseForm.KUKA, f"{{{{{KUKA}}}}}"),
     (PoseForm.EULER, "[[{}, {}, {}], [{}, {}, {}]]"), (PoseForm.ABB, ABB),
     (PoseForm.ABB, f"  LOCAL CONST robtarget p10:={ABB};"),
     (PoseForm.UR, "global seen_p=p[{}, {}, {}, {}, {}, {}]"),
     (PoseForm.KUKA, f"{{{{E6POS: {KUKA}, S 2, T 35, E1 0.0, E2 0.0, E3 0.0, E4 0.0, E5 0.0, E6 0.0}}}}"),
     (PoseForm.KUKA, f"DECL E6POS XP1={{{{{KUKA},S 6,T 27,E1 0.0}}}}"),
     (PoseForm.KUKA, f"{{{{FRAME: {KUKA}}}}}"),
     (PoseForm.KUKA, KUKA.replace(" {", "={"))],
)  # fmt: skip
@pytest.mark.parametrize("name", ["", "a.png ", '"a.png",', "a.png: "])
def test_what_robots_print_is_read(form: PoseForm, line: str, name: str, tmp_path: Path) -> None:
    turn = Rotation.from_euler("ZYX", [30.0, -20.0, 10.0], degrees=True)
    angles = {PoseForm.UR: turn.as_rotvec(), PoseForm.ABB: turn.as_quat()[[3, 0, 1, 2]]}
    values = [*np.array([0.5, -0.25, 1.0]) * (1e3 if form in (PoseForm.KUKA, PoseForm.ABB) else 1.0),
              *angles.get(form, [30.0, -20.0, 10.0])]  # fmt: skip
    text = line.format(*map(float, values))
    named = name and text[0] in "p{[X"  # a declaration has its own name
    for written in (text, " ".join(map(str, map(float, values)))):
        (tmp_path / "poses.txt").write_text(2 * f"{name if named else ''}{written}\n", "utf-8")
        found = read_robot_poses(tmp_path / "poses.txt", form)
        assert found.names == (("a.png", "a.png") if named else None)
        np.testing.assert_allclose(found.X_BT[0, :3, 3], (0.5, -0.25, 1.0))
        np.testing.assert_allclose(found.X_BT[0, :3, :3], turn.as_matrix(), atol=1e-12)
