"""Samples as other programs and spreadsheets keep them, rotations read in another convention, one camera's
file.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from protocol.errors import ConfigurationError, MeasurementFailed, RequestRefused
from testbed.choices import PoseForm
from testbed.hand_eye import picture_samples
from testbed.hand_eye.importer import load
from testbed.hand_eye.pose_text import read_robot_poses
from testbed.hand_eye.trajectories import Trajectory, load_tum, pair
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core.hand_eye.samples import PosePairs, pose_pairs
from vision_pc.core.hand_eye.solvers import judgement
from vision_pc.core.se3 import Array

X = se3.transform(
    Rotation.from_euler("xyz", [3.0, -4.0, 92.0], degrees=True).as_matrix(), (0.045, -0.062, 0.118)
)
Z = se3.transform(Rotation.from_euler("xyz", [2.0, 1.0, 40.0], degrees=True).as_matrix(), (0.8, 0.05, 0.02))


def samples(count: int = 15) -> tuple[Array, Array]:
    """Poses (count, 4, 4) of a hand that looks down and of the target in its camera, a little noisy."""
    rng = np.random.default_rng(4)
    hands, cameras = [], []
    for _ in range(count):
        turn = Rotation.from_euler(
            "xyz", np.add((180.0, 0.0, 92.0), rng.uniform(-35.0, 35.0, 3)), degrees=True
        )
        hand = se3.transform(turn.as_matrix(), np.add((0.75, 0.0, 0.65), rng.uniform(-0.15, 0.15, 3)))
        seen = se3.inverse(hand @ X) @ Z
        noise = se3.transform(se3.exp_so3(np.radians(rng.normal(0.0, 0.05, 3))), rng.normal(0.0, 3e-4, 3))
        hands.append(hand)
        cameras.append(seen @ noise)
    return np.stack(hands), np.stack(cameras)


def solved(pairs: PosePairs) -> Array:
    result, found = judgement.believed(pairs, Method.MAXIMUM_LIKELIHOOD)
    assert found.verdict == "good"
    return result.X


def as_ros(pose: Array) -> dict[str, Any]:
    turn = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    return {
        "translation": dict(zip("xyz", pose[:3, 3].tolist(), strict=True)),
        "rotation": dict(zip("xyzw", turn, strict=True)),
    }


def test_forms_of_other_programs_are_read(tmp_path: Path) -> None:
    hand, camera = samples()
    moveit = [{"effector_wrt_world": h.tolist(), "object_wrt_sensor": c.tolist()}
              for h, c in zip(hand, camera, strict=True)]  # fmt: skip
    easy = {
        "samples": [{"robot": as_ros(h), "tracking": as_ros(c)} for h, c in zip(hand, camera, strict=True)]
    }
    files = {
        "moveit.yaml": yaml.safe_dump(moveit).encode(),
        "easy.json": json.dumps(easy).encode("utf-8-sig"),
        "unicode.json": json.dumps(easy).encode("utf-16"),
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        assert np.abs(solved(load(tmp_path / name))[:3, 3] - X[:3, 3]).max() < 1e-3, name


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("c.json", '{"A": [], "B": []}', "has A, B; a list of pose pairs or an object with"),
        ("d.yaml", "a: [", "not YAML"),
        ("e.json", '{"length_unit": "m", "length_unit": "mm"}', "key 'length_unit' is written twice"),
        ("f.json", '{"samples": [\n1,\n]}', r"not JSON: line 3, column 1: '\]}' is unexpected"),
        ("g.json", '{"samples": [', "not JSON: line 1, column 14: the end is unexpected"),
        ("h.json", json.dumps([[np.eye(4).tolist(), [[1, 0, 0, 0]] * 3 + [[1] * 4]]]), "by columns"),
    ],
)
def test_what_is_not_read_is_told_by_what_stands_there(
    tmp_path: Path, name: str, text: str, why: str
) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(RequestRefused, match=why):
        load(tmp_path / name)


def reread(hand: Array, how: Any) -> Array:
    turned = how(Rotation.from_matrix(hand[:, :3, :3])).as_matrix()
    made = hand.copy()
    made[:, :3, :3] = turned
    return made


FIXED = "roll pitch yaw about fixed axes"


@pytest.mark.parametrize(
    ("how", "words"),
    [
        (lambda R: Rotation.from_euler("ZYX", R.as_euler("xyz")), f"{FIXED}, read as Z Y X"),
        (lambda R: Rotation.from_euler("XYZ", R.as_euler("xyz")), f"{FIXED}, read as X Y Z"),
        (lambda R: Rotation.from_euler("xyz", R.as_rotvec()), "a rotation vector, read as roll pitch yaw"),
        (lambda R: Rotation.from_rotvec(R.as_euler("xyz")), f"{FIXED}, read as a rotation vector"),
        (lambda R: Rotation.from_euler("xyz", np.radians(R.as_euler("xyz"))), "radians, read as degrees"),
        (lambda R: Rotation.from_rotvec(np.radians(R.as_rotvec())), "as degrees of a rotation vector"),
        (lambda R: Rotation.from_euler("ZYX", R.as_euler("ZYZ")), "Z Y Z, read as Z Y X"),
    ],
)
@pytest.mark.parametrize("side", ["hand", "camera"])
def test_a_convention_mistaken_is_named(how: Any, words: str, side: str) -> None:
    hand, camera = samples()
    mistaken = (reread(hand, how), camera) if side == "hand" else (hand, reread(camera, how))
    with pytest.raises(MeasurementFailed, match=f"likely.* {side} rotations") as refused:
        judgement.believed(pose_pairs(*mistaken), Method.MAXIMUM_LIKELIHOOD)
    assert refused.value.cause == "measurement.hand_eye.misread"
    assert words in str(refused.value)
    assert "quaternions" not in str(refused.value)


def test_angles_in_radians_are_asked_about_and_can_be_read(tmp_path: Path) -> None:
    hand, _ = samples(4)
    lines = [
        " ".join(f"{v:.12f}" for v in (*h[:3, 3], *Rotation.from_matrix(h[:3, :3]).as_euler("ZYX")))
        for h in hand
    ]
    (tmp_path / "poses.txt").write_text("\n".join(lines))
    with pytest.raises(RequestRefused, match="are they radians"):
        read_robot_poses(tmp_path / "poses.txt", PoseForm.EULER)
    found = read_robot_poses(tmp_path / "poses.txt", PoseForm.EULER_RAD)
    np.testing.assert_allclose(found.X_BT, hand, atol=1e-9)
    (tmp_path / "poses.txt").write_text("0.5 0 1 0 0 170\n")
    with pytest.raises(RequestRefused, match="angle is 170, radians are wanted; are they degrees"):
        read_robot_poses(tmp_path / "poses.txt", PoseForm.EULER_RAD)


NAMED = {  # columns → the axes that a person reads there
    "qx qy qz qw": "xyzw", "qw qx qy qz": "wxyz", "q0 q1 q2 q3": "wxyz", "qs qx qy qz": "wxyz",
    "w i j k": "wxyz", "qr qi qj qk": "wxyz", "qi qj qk qr": "xyzw", "rot.x rot.y rot.z rot.w": "xyzw",
    "roll pitch yaw": "xyz", "yaw_deg pitch_deg roll_deg": "zyx", "rx ry rz": "xyz", "W P R": "xyz",
}  # fmt: skip


@pytest.mark.parametrize("turned", NAMED)
@pytest.mark.parametrize("step", [1, -1])
def test_a_heading_tells_unit_order_and_axes_of_columns(tmp_path: Path, turned: str, step: int) -> None:
    """Whatever the form says of a quaternion, or the order of Euler angles."""
    hand, _ = samples(4)
    axes, rotations = NAMED[turned], Rotation.from_matrix(hand[:, :3, :3])
    forms, cells = [PoseForm.QUATERNION_XYZW, PoseForm.QUATERNION_WXYZ], rotations.as_quat()
    if len(axes) == 3:
        forms, cells = [PoseForm.EULER], rotations.as_euler("ZYX", degrees=True)[:, ::-1]
    turns = cells[:, ["xyzw".index(axis) for axis in axes]]
    rows = np.column_stack([1e3 * hand[:, :3, 3], turns][::step])
    heading, lines = (
        " ".join(["x_mm y_mm z_mm", turned][::step]),
        [" ".join(map(repr, r)) for r in rows.tolist()],
    )
    (tmp_path / "poses.txt").write_text("\n".join([heading, *lines]))
    for form in forms:
        np.testing.assert_allclose(read_robot_poses(tmp_path / "poses.txt", form).X_BT, hand, atol=1e-9)


def test_names_that_do_not_tell_which_column_is_w_are_asked_about(tmp_path: Path) -> None:
    """ABB's q1 is w, q4 is it in aerospace."""
    (tmp_path / "poses.txt").write_text("x y z q1 q2 q3 q4\n0.5 0 1 1 0 0 0\n")
    with pytest.raises(RequestRefused, match="which column is w does not follow from 'x y z q1 q2 q3 q4'"):
        read_robot_poses(tmp_path / "poses.txt", PoseForm.QUATERNION_XYZW)
    found = read_robot_poses(tmp_path / "poses.txt", PoseForm.QUATERNION_WXYZ)
    np.testing.assert_allclose(found.X_BT[0, :3, :3], np.eye(3), atol=1e-12)


def test_poses_are_not_interpolated_over_gaps_whatever_the_clock_counts_from() -> None:
    hand, camera = samples(40)
    times = np.array([k * 0.1 for k in range(40)])
    keep = (times % 1.0) < 0.45
    known = [
        pair(Trajectory(times[keep] + zero, hand[keep]), Trajectory(times + 0.02 + zero, camera))[0]
        for zero in (0.0, 1.7e9)
    ]
    assert len(known[0]) == len(known[1]) == 16


@pytest.mark.parametrize("hold", [1, 2, 3])
def test_of_a_pose_that_a_hand_repeats_on_its_way_the_first_is_taken(hold: int) -> None:
    hand, camera = samples(60)
    times, late, new = 0.04 * np.arange(60), np.arange(60) // hold * hold, np.arange(0, 60, hold)
    pairs, _ = pair(Trajectory(times, hand[late]), Trajectory(times, camera))
    for name, X in zip(pairs.names, pairs.X_BT, strict=True):
        k = round(float(name[2:]) / 0.04)
        place = [np.interp(k, new, hand[new, axis, 3]) for axis in range(3)]
        np.testing.assert_allclose(X[:3, 3], place if k < new[-1] else hand[late[k], :3, 3], atol=1e-9)


def test_a_recording_in_nanoseconds_is_one_in_seconds(tmp_path: Path) -> None:
    for name, scale in (("s", 1.0), ("ns", 1e9)):
        lines = [f"{(1.7e9 + 0.1 * k) * scale:.1f} {k} 0 0 0 0 0 1" for k in range(4)]
        (tmp_path / f"{name}.tum").write_text("\n".join(lines))
    np.testing.assert_allclose(
        load_tum(tmp_path / "ns.tum").time_s, load_tum(tmp_path / "s.tum").time_s, atol=1e-5
    )


ONE_EYE = """
image_width: 1280
image_height: 720
camera_matrix: {rows: 3, cols: 3, data: [900, 0, 640, 0, 900, 360, 0, 0, 1]}
distortion_model: MODEL
distortion_coefficients: {rows: 1, cols: COUNT, data: [COEFFICIENTS]}
"""


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("plumb_bob", "0.1, 0, 0, 0, 0"), ("rational_polynomial", "0.1, 0, 0, 0, 0, 0.02, 0, 0"),
     ("fisheye", "0.1, 0, 0, 0")],
)  # fmt: skip
def test_the_file_of_one_camera_is_enough(tmp_path: Path, model: str, coefficients: str) -> None:
    text = ONE_EYE.replace("MODEL", model).replace("COEFFICIENTS", coefficients)
    text = text.replace("COUNT", str(coefficients.count(",") + 1))
    (tmp_path / "eye.yaml").write_text(text)
    found = picture_samples.read_camera(tmp_path / "eye.yaml", (1280, 720))
    assert found.size == (1280, 720)
    ray = np.array([[0.3, -0.2]])
    straight = 900.0 * ray + (640.0, 360.0)
    if found.bends is None:
        assert found.distortion[0] == 0.1
    else:
        bent = found.bends.project(np.array([[0.3, -0.2, 1.0]]))
        assert np.abs(bent - straight).max() > 1.0
        np.testing.assert_allclose(found.straight(bent), straight, atol=1e-6)


def test_opencvs_file_of_one_camera_takes_the_size_of_the_pictures(tmp_path: Path) -> None:
    text = "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    text += (
        "   data: [900., 0., 640., 0., 900., 360., 0., 0., 1.]\ndistortion_coefficients: !!opencv-matrix\n"
    )
    (tmp_path / "eye.yml").write_text(
        text + "   rows: 5\n   cols: 1\n   dt: d\n   data: [0., 0., 0., 0., 0.]\n"
    )
    assert picture_samples.read_camera(tmp_path / "eye.yml", (1280, 720)).size == (1280, 720)
    eye = {"K": [[900, 0, 640], [0, 900, 360], [0, 0, 1]], "distortion": [0] * 5}
    (tmp_path / "eye.json").write_text(json.dumps(eye))
    (tmp_path / "mm.json").write_text(json.dumps(eye | {"K": [[8, 0, 640], [0, 8, 360], [0, 0, 1]]}))
    for name, told in (("eye.yml", "of pictures of 640x480"), ("eye.json", "of pictures of 640x480"),
                       ("mm.json", r"mm\.json: fx = 8\.0: .* in millimetres")):  # fmt: skip
        with pytest.raises(ConfigurationError, match=told):
            picture_samples.read_camera(tmp_path / name, (640, 480))


@pytest.mark.parametrize("orders", [("xyz", "YZX"), ("xyz", "XZY")])
def test_a_reading_beyond_the_limits_is_not_called_likely(orders: tuple[str, str]) -> None:
    """A turn of the axes leaves rotations alone and 150 mm of translation: nobody's convention."""
    hand, camera = samples()
    moved = reread(hand, lambda R: Rotation.from_euler(orders[0], R.as_euler(orders[1])))
    with pytest.raises(MeasurementFailed) as refused:
        judgement.believed(pose_pairs(moved, camera), Method.MAXIMUM_LIKELIHOOD)
    assert "likely" not in str(refused.value)
