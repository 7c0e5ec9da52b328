"""Calibration files of others become one value with one set of signs; bad ones are refused by file and key.

All files here are written from the formats' descriptions, for one camera whose eyes are known.
"""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from foundation.configuration import load, parse_overrides
from protocol.errors import ConfigurationError
from tests.vision_pc.conftest import VISION_YAML
from vision_pc.config.camera_files.reading import read_calibration, read_calibrations, write_calibration
from vision_pc.config.choices import LensModel
from vision_pc.config.stereo_camera import StereoCalibration
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception.rectification import rectified_camera

SIZE = (1280, 720)
K1 = np.array([[700.1, 0.0, 641.2], [0.0, 699.4, 355.7], [0.0, 0.0, 1.0]])
K2 = np.array([[698.3, 0.0, 638.9], [0.0, 697.9, 362.4], [0.0, 0.0, 1.0]])
D1 = (-0.17, 0.025, 0.0003, -0.0002, 0.001)
D2 = (-0.168, 0.024, -0.0001, 0.0004, 0.0)
FISHEYE1, FISHEYE2 = (0.02, -0.01, 0.003, -0.0005), (0.021, -0.011, 0.002, -0.0004)
TURN = np.array(
    [-0.0042, 0.0085, -0.0015]
)  # of R_RL: a point p of the left eye is at R p + T in the right one
R = cv2.Rodrigues(TURN)[0]
T = np.array([-0.1199, 0.0003, -0.0008])

STORED = {"M1": K1.tolist(), "D1": [D1], "M2": K2.tolist(), "D2": [D2], "R": R.tolist(), "T": T.tolist()}
ZED = """\
[LEFT_CAM_2K]
fx=1400.2
fy=1398.8
cx=1104.0
cy=620.0
k1=-0.17
k2=0.025
p1=0
p2=0
k3=0
[LEFT_CAM_HD]
fx = 700.1
fy = 699.4
cx = 641.2
cy = 355.7
k1 = -0.17
k2 = 0.025
p1 = 0.0003
p2 = -0.0002
k3 = 0.001

[RIGHT_CAM_HD]
fx=698.3
fy=697.9
cx=638.9
cy=362.4
k1=-0.168
k2=0.024
p1=-0.0001
p2=0.0004
k3=0

[STEREO]
Baseline=119.9
TY=0.3
TZ=-0.8
CV_2K=0.01
CV_HD=0.0085
RX_HD=-0.0042
RZ_HD=-0.0015

[MISC]
Sensor_ID=1
"""


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def camchain(model: str = "radtan", coefficients: tuple[tuple[float, ...], ...] = (D1[:4], D2[:4])) -> str:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, T
    cams = []
    for k, (K, D) in enumerate(zip((K1, K2), coefficients, strict=True)):
        places = [float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]
        chain = f"  T_cn_cnm1: {X.tolist()}\n" if k else ""
        cams.append(
            f"cam{k}:\n  camera_model: pinhole\n  intrinsics: {places}\n  distortion_model: {model}\n"
            f"  distortion_coeffs: {list(D)}\n  resolution: {list(SIZE)}\n{chain}"
            f"  rostopic: /cam{k}/image_raw\n"
        )
    return "".join(cams)


def camera_infos() -> tuple[str, str]:
    """As ROS's camera_calibration writes them, rectified by cv2.stereoRectify."""
    R1, R2, P1, P2, *_ = cv2.stereoRectify(K1, np.array(D1), K2, np.array(D2), SIZE, R, T, alpha=0.0)
    texts = []
    for name, K, D, R_rectified, P in (("left", K1, D1, R1, P1), ("right", K2, D2, R2, P2)):
        entry = "{}: {{rows: {}, cols: {}, data: {}}}\n".format
        texts.append(
            f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: {name}\n"
            + entry("camera_matrix", 3, 3, K.ravel().tolist())
            + "distortion_model: plumb_bob\n"
            + entry("distortion_coefficients", 1, 5, list(D))
            + entry("rectification_matrix", 3, 3, R_rectified.ravel().tolist())
            + entry("projection_matrix", 3, 4, P.ravel().tolist())
        )
    return texts[0], texts[1]


def storage(path: Path, unit: float = 1.0, **matrices: np.ndarray) -> Path:
    """A file of OpenCV's own FileStorage."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in matrices.items():
        file.write(name, np.asarray(value, dtype=np.float64) * (unit if name == "T" else 1.0))
    file.release()
    return path


def check(found: StereoCalibration, coefficients: tuple[tuple[float, ...], ...] = (D1, D2)) -> None:
    """The camera of this file."""
    assert (found.width_px, found.height_px) == SIZE
    for eye, K, D in ((found.left, K1, coefficients[0]), (found.right, K2, coefficients[1])):
        np.testing.assert_allclose(
            (eye.fx_px, eye.fy_px, eye.cx_px, eye.cy_px), K[[0, 1, 0, 1], [0, 1, 2, 2]]
        )
        np.testing.assert_allclose(eye.distortion, D)
    R_LR = cv2.Rodrigues(np.radians(np.array(found.right_rotation_vector_deg)))[0]
    np.testing.assert_allclose(R_LR, R.T, atol=1e-12)
    np.testing.assert_allclose(found.right_position_m, -R.T @ T, atol=1e-12)


def test_a_zed_file_is_read_at_the_size_that_is_asked_for(tmp_path: Path) -> None:
    check(read_calibration(write(tmp_path / "SN1.conf", ZED), SIZE))


def test_older_zed_files_have_no_small_shifts_and_half_of_them_is_refused(tmp_path: Path) -> None:
    lines = ("TY=0.3\n", "TZ=-0.8\n")
    found = read_calibration(
        write(tmp_path / "SN1.conf", ZED.replace(lines[0], "").replace(lines[1], "")), SIZE
    )
    t_RL = -R @ np.array(found.right_position_m)
    np.testing.assert_allclose(t_RL, T * [1.0, 0.0, 0.0], atol=1e-12)
    for line in lines:
        with pytest.raises(ConfigurationError, match=f"{line[:2]}_HD is missing: mm"):
            read_calibration(write(tmp_path / "SN1.conf", ZED.replace(line, "")), SIZE)


def test_newer_zed_files_hold_the_distortion_apart_and_shifts_by_resolution(tmp_path: Path) -> None:
    eye = "[{}_CAM_HD]\nfx=700\nfy=700\ncx=640\ncy=360\n"
    bent = "[{}_DISTO]\nk1=-0.1\nk2=0.02\np1=0.001\np2=0\nk3=0.01\nk4=0.2\nk5=0.01\nk6=0.003\n"
    stereo = "[STEREO]\nBaseline=120\nTY=9\nTY_HD=0.1\nTZ_HD=0.2\nCV_HD=0\nRX_HD=0\nRZ_HD=0\n"
    text = "".join(part.format(side) for part in (eye, bent) for side in ("LEFT", "RIGHT")) + stereo
    found = read_calibration(write(tmp_path / "SN2.conf", text), SIZE)
    assert found.left.lens is LensModel.RATIONAL
    assert found.left.distortion == (-0.1, 0.02, 0.001, 0.0, 0.01, 0.2, 0.01, 0.003)
    np.testing.assert_allclose(found.right_position_m, (0.12, -0.0001, -0.0002))


def test_kalibrs_camchain(tmp_path: Path) -> None:
    check(read_calibration(write(tmp_path / "camchain.yaml", camchain())), ((*D1[:4], 0.0), (*D2[:4], 0.0)))
    fisheye = write(tmp_path / "fisheye.yaml", camchain("equidistant", (FISHEYE1, FISHEYE2)))
    found = read_calibration(fisheye)
    assert found.left.lens is LensModel.FISHEYE
    check(found, (FISHEYE1, FISHEYE2))


def test_two_camera_infos_of_ros(tmp_path: Path) -> None:
    left, right = camera_infos()
    paths = [write(tmp_path / "left.yaml", left), write(tmp_path / "right.yaml", right)]
    check(read_calibrations(paths))
    with pytest.raises(ConfigurationError, match=r"right\.yaml: projection_matrix.*the right eye's file"):
        read_calibrations(paths[::-1])
    with pytest.raises(ConfigurationError, match="one eye, both are wanted: longreach camera convert"):
        read_calibration(paths[0])


def test_what_opencv_stores(tmp_path: Path) -> None:
    both = storage(tmp_path / "stereo.yml", 1000.0, M1=K1, D1=np.array([D1]), M2=K2, D2=np.array([D2]), R=R,
                   T=T.reshape(3, 1))  # fmt: skip
    check(read_calibration(both, SIZE, length_m=0.001))
    inner = storage(tmp_path / "intrinsics.yml", M1=K1, D1=np.array([D1]), M2=K2, D2=np.array([D2]))
    outer = storage(tmp_path / "extrinsics.yml", R=R, T=T.reshape(3, 1))
    check(read_calibrations([inner, outer], SIZE))
    with pytest.raises(ConfigurationError, match=r"image_width, image_height is missing: .*--size"):
        read_calibration(both)
    with pytest.raises(ConfigurationError, match=r"119\.9.* m apart, 0\.005 to 2 are believed; likely milli"):
        read_calibration(both, SIZE)


def test_our_own_file_gives_the_same_numbers_back(tmp_path: Path) -> None:
    first = read_calibration(write(tmp_path / "SN1.conf", ZED), SIZE)
    known = first.model_copy(update={"rms_px": 0.12})
    write_calibration(tmp_path / "camera.yaml", known)
    again = read_calibration(tmp_path / "camera.yaml")
    assert again == known


@pytest.mark.parametrize(
    ("was", "becomes", "told"),
    [
        ("fx = 700.1", "fx = abc", r"SN1\.conf: \[LEFT_CAM_HD\] fx = 'abc': a finite number is wanted"),
        ("fx = 700.1", "fx = nan", r"\[LEFT_CAM_HD\] fx = 'nan': a finite number is wanted"),
        ("fx = 700.1\n", "", r"\[LEFT_CAM_HD\] fx is missing"),
        ("[RIGHT_CAM_HD]", "[RIGHT_CAM_FHD]", r"\[RIGHT_CAM_HD\] is missing: .*1280x720.* has LEFT_CAM_2K"),
        ("RX_HD=-0.0042\n", "", r"\[STEREO\] RX_HD is missing: radians"),
        ("Baseline=119.9", "Baseline=0.1199", r"0\.00086\d* m apart.*likely millimetres"),
        ("Baseline=119.9", "Baseline=-119.9", r"not to the right of the first"),
        ("CV_HD=0.0085", "CV_HD=1.2", r"turned by 68\.\d degrees, at most 45"),
        ("cx = 641.2", "cx = 1641.2", r"eye's cx = 1641\.2: 1001 px from the middle of pictures of 1280x720"),
        ("[MISC]", "[STEREO]", r"no ZED file: .*section 'STEREO' already exists"),
    ],
)
def test_a_bad_zed_file_is_refused_by_key_and_value(
    tmp_path: Path, was: str, becomes: str, told: str
) -> None:
    assert was in ZED
    path = write(tmp_path / "SN1.conf", ZED.replace(was, becomes))
    with pytest.raises(ConfigurationError, match=told) as refusal:
        read_calibration(path, SIZE)
    assert "\n" not in str(refusal.value)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty; a ZED file"),
        ("a: 1\n", "has a; a ZED file"),
        ("- 1\n", "keys with values are wanted"),
        (camchain().replace("pinhole", "omni"), r"cam0\.camera_model = 'omni': pinhole is wanted"),
        (camchain().replace("radtan", "fov"), r"distortion_model = 'fov': radtan, equidistant or none"),
        (camchain().replace("T_cn_cnm1", "T_cam_imu"), r"cam1\.T_cn_cnm1 is missing"),
        (camchain("equidistant", (D1, D2)), r"cam0\.distortion_coeffs = .*4 coefficients"),
        (
            camchain("radtan", ((0.1, 0.2, 0.3), D2[:4])),
            r"cam0\.distortion_coeffs = .*4 coefficients of radt",
        ),
        (camchain().replace("[1280, 720]", "[1280]"), r"cam0\.resolution = .*2 numbers are wanted, got 1"),
        ("%YAML:1.0\n---\nM1: [1, 2\n", "no FileStorage of OpenCV"),
        (json.dumps(STORED | {"M1": K1.T.tolist()}), r"K1 = \[\[700.*wanted in rows; MATLAB"),
        (json.dumps(STORED | {"M1": [[8, 0, 640], [0, 8, 360], [0, 0, 1]]}), r"left eye's fx = 8\.0.*millim"),
        (json.dumps(STORED | {"imageSize": [640, 360]}), "px from the middle of pictures of 640x360"),
        (
            json.dumps(STORED | {"cameraMatrix1": K2.tolist()}),
            r"cameraMatrix1 = .*another name of it has somet",
        ),
        (
            json.dumps(STORED | {"D1": [-0.02, 0.03, -0.025, 0.006]}),
            r"D1 = .*k4 of cv2\.fisheye, or k1 k2 p1",
        ),
        ("%YAML:1.0\n---\nM1: 3\n", r"D1 is missing: as cv2\.stereoCalibrate"),
    ],
)
def test_other_bad_files_are_refused_in_one_line(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(ConfigurationError, match=told) as refusal:
        read_calibration(write(tmp_path / "camera.yaml", text), SIZE)
    assert "\n" not in str(refusal.value)


def test_binary_absent_and_mirrored_files(tmp_path: Path) -> None:
    (tmp_path / "svo.yaml").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(ConfigurationError, match="no text at byte 0"):
        read_calibration(tmp_path / "svo.yaml")
    with pytest.raises(ConfigurationError, match="No such file"):
        read_calibration(tmp_path / "none.yaml")
    mirrored = camchain().replace(f"{float(R[0, 0])}", f"{-float(R[0, 0])}")
    with pytest.raises(ConfigurationError, match="a rotation is wanted"):
        read_calibration(write(tmp_path / "mirrored.yaml", mirrored))


def test_the_configuration_takes_a_file_in_place_of_numbers(tmp_path: Path) -> None:
    path = write(tmp_path / "SN1.conf", ZED)
    asked = parse_overrides([f"vision.camera.calibration={path}"])["vision"]
    config = load(VisionConfig, VISION_YAML, asked)
    assert isinstance(config.camera.calibration, StereoCalibration)
    check(config.camera.calibration)
    assert VisionConfig.model_validate(config.model_dump()) == config


@pytest.mark.parametrize(
    ("assignments", "told"),
    [
        (["vision.camera.calibration=camera.yaml"], "camera.yaml: No such file"),
        (["vision.camera.calibration={left: {fx_px: 10}}"], r"calibration\.rectified\.left\.fx_px = 10"),
    ],
)
def test_two_cameras_at_once_and_absent_files_are_refused(assignments: list[str], told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        load(VisionConfig, VISION_YAML, parse_overrides(assignments)["vision"])


def test_a_file_for_another_size_says_both(tmp_path: Path) -> None:
    path = write(tmp_path / "camchain.yaml", camchain())
    sizes = ["vision.camera.width_px=1920", "vision.camera.height_px=1080"]
    asked = [f"vision.camera.calibration={path}", *sizes]
    with pytest.raises(ConfigurationError, match=r"of 1280x720 px.* are 1920x1080") as refusal:
        load(VisionConfig, VISION_YAML, parse_overrides(asked)["vision"])
    assert refusal.value.cause == "configuration.calibration_size"
    asked[0] = f"vision.camera.calibration={write(tmp_path / 'SN1.conf', ZED)}"
    with pytest.raises(ConfigurationError, match=r"\[LEFT_CAM_FHD\] is missing"):
        load(VisionConfig, VISION_YAML, parse_overrides(asked)["vision"])
    asked[1] = "vision.camera.width_px=1000"
    with pytest.raises(ConfigurationError, match="no ZED takes pictures of 1000x1080 px"):
        load(VisionConfig, VISION_YAML, parse_overrides(asked)["vision"])


def test_thin_prism_is_refused_in_every_form(tmp_path: Path) -> None:
    zed = ZED.replace("k1=", "s1=0.002\nk1=")
    assert zed != ZED
    left, right = camera_infos()
    bent = left.replace("plumb_bob", "rational_polynomial")
    data = ", ".join(["0.1"] * 8 + ["0.002", "0", "0", "0"])
    five = r"(distortion_coefficients:.*?)cols: \d+(.*?data: )\[[^]]*\]"
    bent = re.sub(five, rf"\1cols: 12\2[{data}]", bent, flags=re.S)
    for paths in (
        [write(tmp_path / "SN.conf", zed)],
        [write(tmp_path / "left.yaml", bent), write(tmp_path / "right.yaml", right)],
    ):
        with pytest.raises(ConfigurationError, match=r"thin prism and tilted sensor .* are not modelled"):
            read_calibrations(paths, SIZE)


def test_both_eyes_with_one_projection_matrix_are_asked_about(tmp_path: Path) -> None:
    _, right = camera_infos()
    paths = [write(tmp_path / "left.yaml", right), write(tmp_path / "right.yaml", right)]
    with pytest.raises(ConfigurationError, match=r"left\.yaml: projection_matrix\[3\] = -.*: 0 is wanted"):
        read_calibrations(paths)


def test_what_topics_print_is_read_with_the_dashes_behind_it(tmp_path: Path) -> None:
    check(
        read_calibrations(
            [write(tmp_path / f"{k}.yaml", text + "---\n") for k, text in enumerate(camera_infos())]
        )
    )


def test_a_fisheye_that_says_so_as_a_camera_model_is_one(tmp_path: Path) -> None:
    texts = [
        re.sub(r"distortion_coefficients: {.*?}", "distortion_coefficients: {data: [0.176, -0.032, 0, 0]}",
               text.replace("distortion_model: plumb_bob", "camera_model: fisheye"), flags=re.S)
        for text in camera_infos()
    ]  # fmt: skip
    found = read_calibrations([write(tmp_path / f"{k}.yaml", text) for k, text in enumerate(texts)])
    assert found.left.lens is LensModel.FISHEYE


@pytest.mark.parametrize("form", ["T_imu_cam", "T_cam_imu", "T_BS"])
def test_the_right_eye_follows_from_both_poses_to_the_inertial_unit(tmp_path: Path, form: str) -> None:
    X_IL = np.eye(4)
    X_IL[:3, :3], X_IL[:3, 3] = cv2.Rodrigues(np.array([0.3, -1.1, 0.7]))[0], (0.02, -0.06, 0.01)
    X_RL = np.eye(4)
    X_RL[:3, :3], X_RL[:3, 3] = R, T.ravel()
    poses = [X_IL, X_IL @ np.linalg.inv(X_RL)]
    cameras = []
    for K, D, X in zip((K1, K2), (D1, D2), poses, strict=True):
        given = np.linalg.inv(X) if form == "T_cam_imu" else X
        cameras.append({"camera_model": "pinhole", "resolution": list(SIZE), form: given.tolist(),
                        "intrinsics": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]})  # fmt: skip
        radial = [float(value) for value in D[:4]]
        if form == "T_BS":
            cameras[-1] |= {"distortion_model": "radial-tangential", "distortion_coefficients": radial}
        else:
            cameras[-1] |= {"distortion_model": "radtan", "distortion_coeffs": radial}
    cameras = [yaml.safe_load(json.dumps(camera, default=float)) for camera in cameras]
    if form == "T_BS":
        paths = [write(tmp_path / f"cam{k}.yaml", yaml.safe_dump(camera)) for k, camera in enumerate(cameras)]
    else:
        chain = "%YAML:1.0\n\n" + yaml.safe_dump({f"cam{k}": camera for k, camera in enumerate(cameras)})
        paths = [write(tmp_path / "chain.yaml", chain)]
    check(read_calibrations(paths), ((*D1[:4], 0.0), (*D2[:4], 0.0)))


def test_a_fisheye_wider_than_a_pinhole_shows_is_read(tmp_path: Path) -> None:
    """165 degrees across: the corners lie beyond 88 degrees from the axis; no fold."""
    eye = "  camera_model: pinhole\n  distortion_model: equidistant\n  resolution: [848, 800]\n"
    lens = "  intrinsics: [282.0, 280.7, 416.0, 396.7]\n  distortion_coeffs: [-0.0032, 0.0541, -0.0517, {}]\n"
    beside = "  T_cn_cnm1: [[1, 0, 0, -0.0637], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    text = f"cam0:\n{eye}{lens}cam1:\n{eye}{lens}{beside}"
    wide = read_calibration(write(tmp_path / "wide.yaml", text.replace("{}", "0.0108")))
    camera = rectified_camera(wide)
    assert 0.5 * 282.0 <= camera.left.K[0, 0] < 282.0  # of a smaller one nothing is left to see
    folded = read_calibration(write(tmp_path / "folded.yaml", text.replace("{}", "-0.08")))
    with pytest.raises(ConfigurationError, match="folds over"):
        rectified_camera(folded)
