"""Calibrations that others keep in YAML: ROS ``camera_info``, Kalibr's camchain, OpenCV's FileStorage."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from protocol.errors import ConfigurationError
from vision_pc.config.camera_files.parts import (
    Matrix,
    Pinhole,
    assembled,
    brown_or_rational,
    equidistant,
    matrix,
    missing,
    number,
    numbers,
    refused,
)
from vision_pc.config.stereo_camera import StereoCalibration

_STANDS_M = 1e-4  # how far from the first eye the left one may be by its file
_STEREO = {  # ours → names that OpenCV's samples and others write
    "K1": ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "K_left", "left_K"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "D_left", "left_D"),
    "K2": ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "K_right", "right_K"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "D_right", "right_D"),
    "R": ("R",),
    "T": ("T",),
}


def is_kalibr(document: Mapping[str, Any]) -> bool:
    """Whether this is a camchain of Kalibr."""
    return "cam0" in document


def is_camera_info(document: Mapping[str, Any]) -> bool:
    """Whether this is one eye's ``camera_info``."""
    return {"camera_matrix", "distortion_coefficients"} <= set(document) or {"K", "D", "P"} <= _upper(
        document
    )


def is_opencv_stereo(document: Mapping[str, Any]) -> bool:
    """Whether this holds a part of what cv2.stereoCalibrate returns."""
    names = set(_STEREO["K1"]) | {"T"}
    return bool(names & set(document))


def _upper(document: Mapping[str, Any]) -> set[str]:
    return {str(key).upper() for key in document}


def read_kalibr(path: Path, document: Mapping[str, Any]) -> StereoCalibration:
    """From a camchain: cam0 is the left eye; cam1's ``T_cn_cnm1`` takes points of cam0 to cam1 (m).

    Raises ConfigurationError.
    """
    eyes = []
    for name in ("cam0", "cam1"):
        cam = document.get(name)
        if not isinstance(cam, Mapping):
            raise missing(path, name, "a camchain of two cameras")
        eyes.append(_kalibr_eye(path, name, cam))
    X_RC, key = _from_left_to_right(path, document["cam0"], document["cam1"])
    source = f"{path.name}, camchain, by {key}"
    return assembled(path, source, (eyes[0], eyes[1]), X_RC[:3, :3], X_RC[:3, 3])


def _from_left_to_right(path: Path, cam0: Mapping[str, Any], cam1: Mapping[str, Any]) -> tuple[Matrix, str]:
    """What takes points of cam0 to cam1 (4, 4), m, and the key that told: between the eyes, or each eye's
    pose to the inertial unit. Raises ConfigurationError.
    """
    if "T_cn_cnm1" in cam1:
        return matrix(path, "cam1.T_cn_cnm1", cam1["T_cn_cnm1"], (4, 4)), "T_cn_cnm1"
    for key in ("T_cam_imu", "T_imu_cam"):
        if key in cam0 and key in cam1:
            left, right = (matrix(path, f"{name}.{key}", cam[key], (4, 4))
                           for name, cam in (("cam0", cam0), ("cam1", cam1)))  # fmt: skip
            if key == "T_cam_imu":
                return np.asarray(right @ _inverse(left)), key
            return np.asarray(_inverse(right) @ left), key
    expected = "4x4, from cam0 to cam1; or T_cam_imu or T_imu_cam of both cameras"
    raise missing(path, "cam1.T_cn_cnm1", expected)


def _inverse(X: Matrix) -> Matrix:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = X[:3, :3].T, -X[:3, :3].T @ X[:3, 3]
    return made


def is_sensor(document: Mapping[str, Any]) -> bool:
    """Whether this is one camera's file of a data set in ASL's form, as EuRoC's."""
    return "T_BS" in document and "intrinsics" in document


def read_sensors(
    left: tuple[Path, Mapping[str, Any]], right: tuple[Path, Mapping[str, Any]]
) -> StereoCalibration:
    """From both cameras' files in ASL's form: ``T_BS`` takes points of a camera to the body (m). Raises
    ConfigurationError.
    """
    eyes = [sensor_eye(*one) for one in (left, right)]
    X_BL, X_BR = (
        matrix(
            path, "T_BS", value.get("data") if isinstance(value := sensor["T_BS"], Mapping) else value, (4, 4)
        )
        for path, sensor in (left, right)
    )
    X_RL = _inverse(X_BR) @ X_BL
    source = f"{left[0].name} and {right[0].name}, by T_BS"
    return assembled(left[0], source, (eyes[0], eyes[1]), X_RL[:3, :3], X_RL[:3, 3])


def sensor_eye(path: Path, sensor: Mapping[str, Any]) -> Pinhole:
    """One camera in ASL's form, which differs from Kalibr's in two names."""
    kinds = {"radial-tangential": "radtan"}
    kind = sensor.get("distortion_model", "none")
    model = {
        "distortion_coeffs": sensor.get("distortion_coefficients", []),
        "distortion_model": kinds.get(kind, kind),
    }
    return _kalibr_eye(path, "camera", {**sensor, **model})


def _kalibr_eye(path: Path, name: str, cam: Mapping[str, Any]) -> Pinhole:
    if cam.get("camera_model") != "pinhole":
        raise refused(path, f"{name}.camera_model", cam.get("camera_model"), "pinhole is wanted")
    found = numbers(path, f"{name}.intrinsics", cam.get("intrinsics"))
    if len(found) != 4:
        raise refused(path, f"{name}.intrinsics", list(found), "fu fv pu pv are wanted")
    K: Matrix = np.array([[found[0], 0.0, found[2]], [0.0, found[1], found[3]], [0.0, 0.0, 1.0]])
    kind = cam.get("distortion_model", "none")
    key = f"{name}.distortion_coeffs"
    bends = numbers(path, key, cam.get("distortion_coeffs", []))
    if kind not in ("radtan", "equidistant", "none"):
        raise refused(path, f"{name}.distortion_model", kind, "radtan, equidistant or none is wanted")
    lens = equidistant(path, key, bends) if kind == "equidistant" else brown_or_rational(path, key, bends)
    size = numbers(path, f"{name}.resolution", cam.get("resolution"))
    if len(size) != 2:
        raise refused(path, f"{name}.resolution", list(size), "width and height are wanted")
    return Pinhole(K, *lens, (int(size[0]), int(size[1])))


def read_camera_infos(
    left: tuple[Path, Mapping[str, Any]], right: tuple[Path, Mapping[str, Any]]
) -> StereoCalibration:
    """From the two files of a ROS stereo camera, as ``camera_calibration`` writes them or as messages.

    The rectified right eye is at (-P[3] / P[0], 0, 0) in the rectified left one, and ``R`` turns each eye
    into its rectified axes. Raises ConfigurationError.
    """
    eyes = (camera_info_eye(*left), camera_info_eye(*right))
    _require_first_of_pair(*left)
    turns = [_entry(path, info, "rectification_matrix", "R") for path, info in (left, right)]
    R_left = matrix(left[0], "rectification_matrix", turns[0], (3, 3))
    R_right = matrix(right[0], "rectification_matrix", turns[1], (3, 3))
    path, info = right
    P = matrix(path, "projection_matrix", _entry(path, info, "projection_matrix", "P"), (3, 4))
    if P[0, 0] <= 0.0 or P[0, 3] >= 0.0:
        raise refused(
            path,
            "projection_matrix[3]",
            float(P[0, 3]),
            "-fx times the baseline is wanted, below zero; likely the left eye's file, or a single camera's",
        )
    R_RC = R_right.T @ R_left
    t_RC = R_right.T @ np.array([P[0, 3] / P[0, 0], 0.0, 0.0])
    source = f"{left[0].name} and {path.name}, ROS camera_info"
    return assembled(path, source, eyes, R_RC, t_RC)


def _entry(path: Path, info: Mapping[str, Any], name: str, short: str) -> Any:
    for key in (name, short, short.lower()):
        if key in info:
            value = info[key]
            return value.get("data") if isinstance(value, Mapping) else value
    raise missing(path, name, "as camera_calibration writes it")


def camera_info_eye(path: Path, info: Mapping[str, Any], size: tuple[int, int] | None = None) -> Pinhole:
    """One eye of ROS, or of OpenCV under the same names; ``size`` stands in where it has none. Raises
    ConfigurationError.
    """
    K = matrix(path, "camera_matrix", _entry(path, info, "camera_matrix", "K"), (3, 3))
    values = numbers(path, "distortion_coefficients", _entry(path, info, "distortion_coefficients", "D"))
    kind = info.get("distortion_model", info.get("camera_model", "plumb_bob"))
    kind = "plumb_bob" if kind == "pinhole" else kind
    if kind in ("equidistant", "fisheye"):
        lens = equidistant(path, "distortion_coefficients", values)
    elif kind in ("plumb_bob", "rational_polynomial"):
        lens = brown_or_rational(path, "distortion_coefficients", values)
    else:
        wanted = "plumb_bob, rational_polynomial or equidistant is wanted"
        raise refused(path, "distortion_model", kind, wanted)
    if size is not None and "image_width" not in info and "width" not in info:
        return Pinhole(K, *lens, size)
    width, height = (int(number(path, key, _entry(path, info, key, key.removeprefix("image_"))))
                     for key in ("image_width", "image_height"))  # fmt: skip
    return Pinhole(K, *lens, (width, height))


def _require_first_of_pair(path: Path, info: Mapping[str, Any]) -> None:
    """Raises ConfigurationError where the left eye's file says that it stands beside another."""
    P = matrix(path, "projection_matrix", _entry(path, info, "projection_matrix", "P"), (3, 4))
    if abs(P[0, 3]) > _STANDS_M * abs(P[0, 0]):
        raise refused(
            path,
            "projection_matrix[3]",
            float(P[0, 3]),
            "0 is wanted of the left eye, from which the right one's is counted; is it the right eye's file, "
            "or does one program give both eyes the same P?",
        )


def read_opencv_stereo(
    path: Path, document: Mapping[str, Any], size: tuple[int, int] | None, length_m: float
) -> StereoCalibration:
    """From what cv2.stereoCalibrate returns, under the names of OpenCV's samples; a point p of the left eye
    is at R p + T in the right one, T in units of ``length_m``.

    Such files hold no picture size: ``size``, or image_width and image_height beside. Raises
    ConfigurationError.
    """
    found = {ours: _entry_named(path, document, names) for ours, names in _STEREO.items()}
    if "image_width" in document and "image_height" in document:
        size = (int(number(path, "image_width", document["image_width"])),
                int(number(path, "image_height", document["image_height"])))  # fmt: skip
    if size is None:
        raise missing(
            path, "image_width, image_height", "the pictures' size is needed: give --size WIDTHxHEIGHT"
        )
    fisheye = str(document.get("model", "")).lower() == "fisheye"
    eyes = []
    for k in "12":
        K = matrix(path, f"K{k}", found[f"K{k}"], (3, 3))
        values = numbers(path, f"D{k}", found[f"D{k}"])
        lens = equidistant(path, f"D{k}", values) if fisheye else brown_or_rational(path, f"D{k}", values)
        eyes.append(Pinhole(K, *lens, size))
    R = matrix(path, "R", found["R"], (3, 3))
    T = length_m * matrix(path, "T", found["T"], (3, 1)).ravel()
    return assembled(path, f"{path.name}, OpenCV", (eyes[0], eyes[1]), R, T)


def _entry_named(path: Path, document: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    for name in names:
        if name in document:
            return document[name]
    raise missing(
        path, names[0], f"as cv2.stereoCalibrate returns it; also read: {', '.join(names[1:]) or 'none'}"
    )


def one_eye_alone(path: Path) -> ConfigurationError:
    """The error of a file that holds one eye where both are wanted."""
    return ConfigurationError(
        "configuration.bad_calibration",
        f"{path}: is the file of one eye, both are wanted: longreach camera convert LEFT RIGHT --out FILE",
    )
