"""Calibrations in YAML: ROS ``camera_info``, Kalibr's camchain, OpenCV's FileStorage, ORB-SLAM3."""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from vision_pc.config.camera_files.parts import Entries, Matrix, Pinhole, assembled, inverse
from vision_pc.config.stereo_camera import StereoCalibration

_SIZE = ("image_width", "image_height")
_SIZES = {"image_size", "imageSize", "img_size", "resolution"}  # others' names, of both
_MOST_TANGENTIAL = 0.01  # [E] p1 and p2 of lenses that sit askew are a few thousandths
_STANDS_M = 1e-4  # how far from the first eye the left one may be by its file
_STEREO = {  # ours → names that OpenCV's samples and others write
    "K1": ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "cameraMatrixL", "K_left", "left_K"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "distCoeffsL", "D_left", "left_D"),
    "K2": ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "cameraMatrixR", "K_right", "right_K"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "distCoeffsR", "D_right", "right_D"),
    "R": ("R",),
    "T": ("T",),
}
_ORB_LENSES = {"PinHole": ("k1", "k2", "p1", "p2", "k3"), "KannalaBrandt8": ("k1", "k2", "k3", "k4")}


def is_camera_info(document: Mapping[str, Any]) -> bool:
    """Whether this is one eye's ``camera_info``."""
    keys = set(document)
    return {"camera_matrix", "distortion_coefficients"} <= keys or {"K", "D", "P"} <= {
        str(k).upper() for k in keys
    }


def is_opencv_stereo(document: Mapping[str, Any]) -> bool:
    """Whether this holds a part of what cv2.stereoCalibrate returns."""
    return bool({*_STEREO["K1"], "T"} & set(document))


def is_sensor(document: Mapping[str, Any]) -> bool:
    """Whether this is one camera's file of a data set in ASL's form, as EuRoC's."""
    return "T_BS" in document and "intrinsics" in document


def read_kalibr(file: Entries) -> StereoCalibration:
    """From a camchain: cam0 is the left eye; cam1's ``T_cn_cnm1`` takes points of cam0 to cam1 (m), or each
    eye's pose to the inertial unit tells. Raises ConfigurationError.
    """
    cameras = []
    for name in ("cam0", "cam1"):
        if not isinstance(file.values.get(name), Mapping):
            raise file.missing(name, "a camchain of two cameras")
        cameras.append(Entries(file.path, file.values[name], f"{name}."))
    left, right = cameras
    eyes = [kalibr_eye(one) for one in cameras]
    for key in ("T_cn_cnm1", "T_cam_imu", "T_imu_cam"):
        if key not in right.values or (key != "T_cn_cnm1" and key not in left.values):
            continue
        X = right.matrix(key, right.values[key], (4, 4))
        if key != "T_cn_cnm1":
            X_left = left.matrix(key, left.values[key], (4, 4))
            X = X @ inverse(X_left) if key == "T_cam_imu" else inverse(X) @ X_left
        return assembled(file.path, f"{file.path.name}, camchain, by {key}", eyes, X[:3, :3], X[:3, 3])
    raise right.missing("T_cn_cnm1", "4x4, from cam0 to cam1; or T_cam_imu or T_imu_cam of both cameras")


def read_sensors(left: Entries, right: Entries) -> StereoCalibration:
    """From both cameras' files in ASL's form: ``T_BS`` takes points of a camera to the body (m). Raises
    ConfigurationError.
    """
    X_BL, X_BR = (one.matrix("T_BS", one.values["T_BS"], (4, 4)) for one in (left, right))
    X_RL = inverse(X_BR) @ X_BL
    source = f"{left.path.name} and {right.path.name}, by T_BS"
    eyes = [kalibr_eye(one) for one in (left, right)]
    return assembled(left.path, source, eyes, X_RL[:3, :3], X_RL[:3, 3])


def kalibr_eye(cam: Entries) -> Pinhole:
    """One camera of Kalibr's, or in ASL's form, which differs in two names. Raises ConfigurationError."""
    if cam.values.get("camera_model") != "pinhole":
        raise cam.refused("camera_model", cam.values.get("camera_model"), "pinhole is wanted")
    fx, fy, cx, cy = cam.numbers("intrinsics", cam.values.get("intrinsics"), 4)
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    kind = cam.values.get("distortion_model", "none")
    counts = {"radtan": 4, "radial-tangential": 4, "equidistant": 4, "none": 0}
    if kind not in counts:
        raise cam.refused("distortion_model", kind, "radtan, equidistant or none is wanted")
    key = "distortion_coefficients" if "distortion_coefficients" in cam.values else "distortion_coeffs"
    values = cam.numbers(key, cam.values.get(key, []))
    if len(values) != counts[kind]:
        raise cam.refused(key, list(values), f"{counts[kind]} coefficients of {kind} are wanted")
    size = cam.numbers("resolution", cam.values.get("resolution"), 2)
    return Pinhole(K, *cam.lens(key, kind, values), cam.size(("resolution",) * 2, size))


def _entry(info: Entries, name: str, short: str) -> Any:
    return info.entry("as camera_calibration writes it", name, short, short.lower())


def read_camera_infos(left: Entries, right: Entries) -> StereoCalibration:
    """From the two files of a ROS stereo camera, as ``camera_calibration`` writes them or as messages.

    The rectified right eye is at (-P[3] / P[0], 0, 0) in the rectified left one, and ``R`` turns each eye
    into its rectified axes. Raises ConfigurationError.
    """
    eyes = [camera_info_eye(one) for one in (left, right)]
    R_left, R_right = (one.matrix("rectification_matrix", _entry(one, "rectification_matrix", "R"), (3, 3))
                       for one in (left, right))  # fmt: skip
    first, P = (one.matrix("projection_matrix", _entry(one, "projection_matrix", "P"), (3, 4))
                for one in (left, right))  # fmt: skip
    if abs(first[0, 3]) > _STANDS_M * abs(first[0, 0]):
        why = (
            "0 is wanted of the left eye, from which the right one's is counted; is it the right eye's file,"
        )
        why += " or does one program give both eyes the same P?"
        raise left.refused("projection_matrix[3]", float(first[0, 3]), why)
    if P[0, 0] <= 0.0 or P[0, 3] >= 0.0:
        why = "-fx times the baseline is wanted, below zero; likely the left eye's file, or a single camera's"
        raise right.refused("projection_matrix[3]", float(P[0, 3]), why)
    right.alike("projection_matrix", P, first)
    t_RC = R_right.T @ np.array([P[0, 3] / P[0, 0], 0.0, 0.0])
    source = f"{left.path.name} and {right.path.name}, ROS camera_info"
    return assembled(left.path, source, eyes, R_right.T @ R_left, t_RC)


def camera_info_eye(info: Entries, size: tuple[int, int] | None = None) -> Pinhole:
    """One eye of ROS, or of OpenCV under the same names; ``size`` stands in where it has none. Raises
    ConfigurationError.
    """
    K = info.camera_matrix("camera_matrix", _entry(info, "camera_matrix", "K"))
    values = info.numbers("distortion_coefficients", _entry(info, "distortion_coefficients", "D"))
    kind = info.values.get("distortion_model", info.values.get("camera_model", "plumb_bob"))
    if kind not in ("plumb_bob", "rational_polynomial", "equidistant", "fisheye", "pinhole"):
        raise info.refused(
            "distortion_model", kind, "plumb_bob, rational_polynomial or equidistant is wanted"
        )
    lens = info.lens("distortion_coefficients", kind, values)
    if size is not None and "image_width" not in info.values and "width" not in info.values:
        return Pinhole(K, *lens, size)
    full = info.size(_SIZE, [_entry(info, key, key.removeprefix("image_")) for key in _SIZE])
    K, taken = _of_window(info, K, full)
    return Pinhole(K, *lens, taken)


def _of_window(info: Entries, K: Matrix, full: tuple[int, int]) -> tuple[Matrix, tuple[int, int]]:
    """``K`` and the size of the pictures, of a file whose K is of the ``full`` sensor: a window (roi) of it
    is taken, and binned. Raises ConfigurationError.
    """
    roi = info.values.get("roi", {})
    if not isinstance(roi, Mapping):
        raise info.refused("roi", roi, "x_offset, y_offset, width and height are wanted")
    K, size = K.copy(), list(full)
    for k, (axis, length) in enumerate((("x", "width"), ("y", "height"))):
        offset = info.number(f"roi.{axis}_offset", roi.get(f"{axis}_offset", 0))
        window = info.number(f"roi.{length}", roi.get(length, 0))
        bins = info.number(f"binning_{axis}", info.values.get(f"binning_{axis}", 0))
        if min(offset, window) < 0.0 or offset + (window or full[k]) > full[k]:
            why = f"a window of {full[k]} px is wanted"
            raise info.refused(f"roi.{axis}_offset, {length}", (offset, window), why)
        if bins < 0.0 or not bins.is_integer():
            raise info.refused(f"binning_{axis}", bins, "a whole number is wanted")
        by = max(bins, 1.0)
        K[k] = (K[k] - offset * K[2]) / by
        size[k] = int((window or full[k]) // by)
    return K, (size[0], size[1])


def read_opencv_stereo(file: Entries, size: tuple[int, int] | None, length_m: float) -> StereoCalibration:
    """From what cv2.stereoCalibrate returns, under the names of OpenCV's samples; a point p of the left eye
    is at R p + T in the right one, T in units of ``length_m``.

    Such files hold no picture size: ``size``, or image_width and image_height beside. Raises
    ConfigurationError.
    """
    found = {}
    for ours, names in _STEREO.items():
        expected = f"as cv2.stereoCalibrate returns it; also read: {', '.join(names[1:]) or 'none'}"
        found[ours] = file.entry(expected, *names)
        for name in names:
            if file.values.get(name, found[ours]) != found[ours]:
                why = f"another name of it has something else: {found[ours]!r}"
                raise file.refused(name, file.values[name], why)
    if set(_SIZE) <= set(file.values):
        size = file.size(_SIZE, [file.values[key] for key in _SIZE])
    for key in _SIZES & set(file.values):
        size = file.size((key, key), file.numbers(key, file.values[key], 2))
    if size is None:
        why = "the pictures' size is needed: give --size WIDTHxHEIGHT"
        raise file.missing("image_width, image_height", why)
    model = str(file.values.get("model", "")).lower()
    if model not in ("", "pinhole", "fisheye"):
        raise file.refused("model", file.values["model"], "pinhole or fisheye is wanted")
    eyes = []
    for k in "12":
        K, D = file.camera_matrix(f"K{k}", found[f"K{k}"]), found[f"D{k}"]
        values = file.numbers(f"D{k}", D)
        column = isinstance(D, Mapping) and str(D.get("rows")) == "4"
        if not model and len(values) == 4 and (column or max(map(abs, values[2:])) > _MOST_TANGENTIAL):
            why = "k1 k2 k3 k4 of cv2.fisheye, or k1 k2 p1 p2? Add model: fisheye or pinhole"
            raise file.refused(f"D{k}", list(values), why)
        eyes.append(Pinhole(K, *file.lens(f"D{k}", model or "pinhole", values), size))
    turn = file.numbers("R", found["R"])
    R = cv2.Rodrigues(np.array(turn))[0] if len(turn) == 3 else file.matrix("R", turn, (3, 3))
    T = length_m * file.matrix("T", found["T"], (3, 1)).ravel()
    return assembled(file.path, f"{file.path.name}, OpenCV", eyes, np.asarray(R, dtype=np.float64), T)


def read_orb_slam(file: Entries) -> StereoCalibration:
    """From the settings of ORB-SLAM3: ``Stereo.T_c1_c2`` takes points of the right eye to the left one (m).
    Raises ConfigurationError.
    """
    kind = file.values.get("Camera.type")
    if kind not in _ORB_LENSES:
        raise file.refused("Camera.type", kind, f"{' or '.join(_ORB_LENSES)} is wanted")
    sizes = ("Camera.width", "Camera.height")
    size = file.size(sizes, [file.number(key) for key in sizes])
    has_k3 = kind != "PinHole" or bool({"Camera1.k3", "Camera2.k3"} & set(file.values))
    eyes = [
        _orb_eye(file, name, _ORB_LENSES[kind][: None if has_k3 else 4], size)
        for name in ("Camera1", "Camera2")
    ]
    X_RC = inverse(file.matrix("Stereo.T_c1_c2", file.values["Stereo.T_c1_c2"], (4, 4)))
    return assembled(file.path, f"{file.path.name}, ORB-SLAM3", eyes, X_RC[:3, :3], X_RC[:3, 3])


def _orb_eye(file: Entries, name: str, coefficients: Sequence[str], size: tuple[int, int]) -> Pinhole:
    K = file.pinhole([f"{name}.{key}" for key in ("fx", "fy", "cx", "cy")])
    values = [file.number(f"{name}.{key}") for key in coefficients]
    return Pinhole(K, *file.lens(f"{name}.k1 …", file.values["Camera.type"], values), size)
