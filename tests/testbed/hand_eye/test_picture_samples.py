"""Robots' forms of a pose against scipy, and pictures with poses all the way to X."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from protocol.errors import RequestRefused
from testbed.choices import PoseForm
from testbed.hand_eye.importer import load
from testbed.hand_eye.picture_samples import matched
from testbed.hand_eye.pose_text import RobotPoses, read_robot_poses
from tests.support.board_pictures import BoardCamera, BoardRenderer, random_board_pose
from tests.support.commands import ran
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core.hand_eye.solvers import judgement
from vision_pc.core.perception.zhang_intrinsics import Checkerboard
from vision_pc.core.se3 import Array

P = np.array([0.4, -0.12, 0.85])
R = Rotation.from_euler("ZYX", [100.0, -35.0, 160.0], degrees=True)
X = se3.transform(R.as_matrix(), P)
WXYZ = R.as_quat()[[3, 0, 1, 2]]


@pytest.mark.parametrize(
    ("form", "values", "words"),
    [
        (PoseForm.QUATERNION_XYZW, [*P, *R.as_quat()], {}),
        (PoseForm.QUATERNION_WXYZ, [*P, *WXYZ], {}),
        (PoseForm.UR, [*P, *R.as_rotvec()], {}),
        (PoseForm.KUKA, [*(1e3 * P), 100.0, -35.0, 160.0], {}),
        (PoseForm.ABB, [*(1e3 * P), *WXYZ], {}),
        (PoseForm.FRANKA, X.T.ravel(), {}),
        (PoseForm.MATRIX, X.ravel(), {}),
        (PoseForm.TUM, [17.5, *P, *R.as_quat()], {}),
        (PoseForm.EULER, [*P, *R.as_euler("XYZ", degrees=True)], {"order": "XYZ"}),
        (PoseForm.EULER, [*P, *R.as_euler("xyz", degrees=True)], {"order": "xyz"}),
        (PoseForm.EULER, [*P, *R.as_euler("ZYZ", degrees=True)], {"order": "ZYZ"}),
        (PoseForm.EULER, [*(100.0 * P), *R.as_euler("zxy", degrees=True)], {"order": "zxy", "unit": "cm"}),
    ],
)
@pytest.mark.parametrize("between", [", ", " ", ";"])
def test_forms(tmp_path: Path, form: PoseForm, values: Array, words: dict[str, Any], between: str) -> None:
    line = between.join(f"{value:.12g}" for value in values)
    (tmp_path / "poses.csv").write_text(f"# robot\npicture{between}pose\na.png{between}{line}\n", "utf-8")
    found = read_robot_poses(tmp_path / "poses.csv", form, **words)
    assert found.names == ("a.png",)
    np.testing.assert_allclose(found.X_BT, [X], atol=1e-9)
    (tmp_path / "poses.csv").write_text(f"{line}\n{line}\n", "utf-8")
    assert read_robot_poses(tmp_path / "poses.csv", form, **words).names is None


@pytest.mark.parametrize(
    ("text", "form", "words", "told"),
    [
        ("1 2 3 0 0 0\n", PoseForm.ABB, {}, "line 1"),
        ("0 0 0 0 0 0 1\n1 2 3 0 0 0 3\n", PoseForm.QUATERNION_XYZW, {}, "line 2"),
        ("1 2 3 0 0 170\n", PoseForm.UR, {}, "degrees"),
        (" ".join(f"{value:.9g}" for value in X.ravel()), PoseForm.FRANKA, {}, "columns"),
        ("1 2 3 0 0 0\n", PoseForm.EULER, {"order": "ZZX"}, "ZZX"),
        ("a 1 2 3 0 0 0\n1 2 3 0 0 0\n", PoseForm.KUKA, {}, "some lines"),
        ("# none\n", PoseForm.KUKA, {}, "no pose"),
    ],
)
def test_bad_poses_are_named(
    tmp_path: Path, text: str, form: PoseForm, words: dict[str, Any], told: str
) -> None:
    (tmp_path / "poses.csv").write_text(text, "utf-8")
    with pytest.raises(RequestRefused, match=told):
        read_robot_poses(tmp_path / "poses.csv", form, **words)


def test_what_is_left_over_is_named() -> None:
    pictures = [Path("a1.png"), Path("a2.png"), Path("a3.png")]
    two = np.stack([X, X])
    for names, told in (
        (None, "2 poses for 3 pictures; left over from a3.png on"),
        (("a1", "a2.png"), "no pose for a3.png"),
        (("a1", "a1"), "named twice a1"),
    ):
        with pytest.raises(RequestRefused, match=told):
            matched(pictures, RobotPoses(two, names), "poses.csv")
    with pytest.raises(RequestRefused, match="no picture for a2"):
        matched(pictures[:1], RobotPoses(two, ("a1", "a2")), "poses.csv")


def test_pictures_and_poses_become_x(tmp_path: Path) -> None:
    camera = BoardCamera(np.array([[620.0, 0, 322.0], [0, 621.0, 238.0], [0, 0, 1.0]]), np.zeros(5), 640, 480)
    board, rng = Checkerboard(7, 6, 0.03), np.random.default_rng(5)
    X_TC = se3.transform(se3.exp_so3([0.3, -0.2, 1.4]), (0.05, -0.03, 0.1))
    X_BP = se3.transform(se3.exp_so3([2.9, 0.2, -0.3]), (0.9, 0.1, 0.2))
    renderer, lines = BoardRenderer(camera), []
    for k in range(10):
        X_CP = random_board_pose(camera, board, rng)
        cv2.imwrite(str(tmp_path / f"view{k}.png"), renderer.render(board, X_CP, rng))
        X_BT = X_BP @ se3.inverse(X_TC @ X_CP)
        angles = Rotation.from_matrix(X_BT[:3, :3]).as_euler("ZYX", degrees=True)
        lines.append(" ".join(f"{value:.9g}" for value in (*(1e3 * X_BT[:3, 3]), *angles)))
    cv2.imwrite(str(tmp_path / "view10.png"), np.full((480, 640), 128, np.uint8))
    (tmp_path / "poses.txt").write_text("\n".join([*lines, lines[0]]), "utf-8")
    (tmp_path / "camera.json").write_text(
        json.dumps({"K": camera.K.tolist(), "distortion": [0.0] * 5}), "utf-8"
    )  # fmt: skip
    words = ["--poses", "kuka", "--columns", "7", "--rows", "6", "--square-mm", "30"]
    files = [tmp_path, tmp_path / "poses.txt", "--camera", tmp_path / "camera.json"]
    to = tmp_path / "samples.json"
    assert "no board in view10.png" in ran("hand-eye", "samples", *files, *words, "--out", to).output
    pairs = load(to)
    assert len(pairs) == 10
    found, verdict = judgement.believed(pairs, Method.ROBUST, False)
    assert found.of_lens is not None
    error = np.concatenate([found.X[:3, 3] - X_TC[:3, 3], se3.log_so3(found.X[:3, :3] @ X_TC[:3, :3].T)])
    assert (np.abs(error) < 4.0 * np.sqrt(np.diag(found.covariance))).all()
    assert np.abs(error[:3]).max() < 2e-3
    assert verdict is not None
