"""Pose pairs from files: every way of writing a pose, every way of getting it wrong."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from laboratory.experiments.hand_eye.scenes import HandEyeScene
from protocol.errors import RequestRefused
from testbed.hand_eye import trajectories
from testbed.hand_eye.importer import FORMAT, ImportOptions, load
from testbed.hand_eye.trajectories import Trajectory
from tests.support.paths import DOCS
from tests.vision_pc.hand_eye.data import exact_pairs, random_scene
from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.se3 import Array


@pytest.fixture
def scene() -> HandEyeScene:
    return random_scene(np.random.default_rng(50), 6)


def written(X: Array, form: str) -> Any:
    q, v = stacks.quaternion_from_rotation(X[None, :3, :3])[0], stacks.log_so3(X[None, :3, :3])[0]
    turns = {"q_wxyz": q, "q_xyzw": q[[1, 2, 3, 0]], "R": X[:3, :3],
             "rotation_vector_rad": v, "rotation_vector_deg": np.degrees(v)}  # fmt: skip
    return X.tolist() if form == "matrix" else {"p": X[:3, 3].tolist(), form: turns[form].tolist()}


def document(scene: HandEyeScene, form: str = "q_wxyz") -> dict[str, Any]:
    samples = [
        {"name": f"s{k}", "hand": written(H, form), "camera": written(P, form), "settled": True}
        | {"marker_id": 582}
        for k, (H, P) in enumerate(zip(scene.X_BT, scene.P(), strict=True))
    ]
    head = {"format": FORMAT, "setup": "eye-in-hand", "length_unit": "m", "marker_id": 582}
    return {**head, "samples": samples}


def saved(tmp_path: Path, data: Any) -> Path:
    path = tmp_path / "samples.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "form", ["matrix", "q_wxyz", "q_xyzw", "rotation_vector_rad", "rotation_vector_deg", "R"]
)
def test_every_way_of_writing_a_pose_is_read(tmp_path: Path, scene: HandEyeScene, form: str) -> None:
    pairs = load(saved(tmp_path, document(scene, form)))
    expected = exact_pairs(scene)
    np.testing.assert_allclose(pairs.H, expected.H, atol=1e-12)
    np.testing.assert_allclose(pairs.P, expected.P, atol=1e-12)
    assert set(pairs.names) == {f"s{k}" for k in range(6)}


def test_bare_pairs_of_matrices_are_read(tmp_path: Path, scene: HandEyeScene) -> None:
    bare = [[H.tolist(), P.tolist()] for H, P in zip(scene.X_BT, scene.P(), strict=True)]
    pairs = load(saved(tmp_path, bare), ImportOptions(setup=Setup.EYE_TO_HAND))
    assert pairs.setup is Setup.EYE_TO_HAND
    np.testing.assert_allclose(pairs.P, exact_pairs(scene).P, atol=1e-12)


def test_millimetres_are_scaled_when_they_are_said_to_be(tmp_path: Path, scene: HandEyeScene) -> None:
    data = document(scene)
    for sample in data["samples"]:
        for side in ("hand", "camera"):
            sample[side]["p"] = [1e3 * v for v in sample[side]["p"]]
    with pytest.raises(RequestRefused, match="millimetres") as caught:
        load(saved(tmp_path, data))
    assert caught.value.cause == "refused.hand_eye.units"
    data["length_unit"] = "mm"
    np.testing.assert_allclose(load(saved(tmp_path, data)).P, exact_pairs(scene).P, atol=1e-12)


def test_inverted_camera_poses_are_turned_round(tmp_path: Path, scene: HandEyeScene) -> None:
    data = document(scene)
    for sample, P in zip(data["samples"], scene.P(), strict=True):
        sample["camera"] = written(stacks.inverse(P), "matrix")
    pairs = load(saved(tmp_path, data), ImportOptions(camera_in_target=True))
    np.testing.assert_allclose(methods.solve(pairs).X, scene.X, atol=1e-9)


def test_printed_quaternions_need_to_be_asked_for(tmp_path: Path, scene: HandEyeScene) -> None:
    data = document(scene)
    data["samples"][2]["hand"]["q_wxyz"] = [0.5 * v for v in data["samples"][2]["hand"]["q_wxyz"]]
    with pytest.raises(RequestRefused, match=r"sample s2: hand: quaternion has norm 0\.500") as caught:
        load(saved(tmp_path, data))
    assert caught.value.cause == "refused.hand_eye.quaternion_norm"
    pairs = load(saved(tmp_path, data), ImportOptions(normalise=True))
    np.testing.assert_allclose(pairs.H, exact_pairs(scene).H, atol=1e-12)


def spoiled(data: dict[str, Any], **changes: Any) -> dict[str, Any]:
    data["samples"][2].update(changes)
    return data


@pytest.mark.parametrize(
    ("changes", "cause", "said"),
    [
        ({"settled": False}, "unsettled", "sample s2: taken before the arm had settled"),
        ({"settled": "yes"}, "format", "true or false is wanted"),
        ({"marker_id": 17}, "marker_id", "sample s2: shows marker 17, marker 582 was asked for"),
        ({"hand": [1, 2, 3]}, "format", "sample s2: hand: 16 numbers are wanted, got 3"),
        ({"hand": "here"}, "format", "sample s2: hand: 16 numbers are wanted"),
        ({"hand": {"p": [0, 0, 0]}}, "format", "exactly one rotation is wanted, got none"),
        (
            {"camera": {"p": [0, 0], "q_wxyz": [1, 0, 0, 0]}},
            "format",
            "camera p: 3 numbers are wanted, got 2",
        ),
        ({"camera": {"p": [0, 0, 0], "rotation_vector_rad": [90, 0, 0]}}, "units", "is it in degrees"),
        ({"camera": {"p": [0, 0, 0], "quat": [1, 0, 0, 0]}}, "format", "unknown key 'quat'"),
        ({"comment": "blurred"}, "format", "sample s2: unknown key 'comment'"),
        ({"name": None, "camera": None}, "format", "camera: 16 numbers are wanted"),
    ],
)
def test_a_bad_sample_is_named(
    tmp_path: Path, scene: HandEyeScene, changes: dict[str, Any], cause: str, said: str
) -> None:
    with pytest.raises(RequestRefused, match=said) as caught:
        load(saved(tmp_path, spoiled(document(scene), **changes)))
    assert caught.value.cause == f"refused.hand_eye.{cause}"
    assert str(caught.value).startswith("samples.json: ")


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        ({"samples": "none"}, "format"),
        ({"samples": [], "sample_rate": 3}, "format"),
        ({"format": "longreach-hand-eye/9", "samples": []}, "format"),
        ({"length_unit": "furlong", "samples": []}, "units"),
        ({"setup": "eye-in-foot", "samples": []}, "format"),
        ([[1, 2, 3]], "count"),
        (7, "format"),
    ],
)
def test_a_bad_document_is_refused(tmp_path: Path, data: Any, cause: str) -> None:
    with pytest.raises(RequestRefused) as caught:
        load(saved(tmp_path, data))
    assert caught.value.cause == f"refused.hand_eye.{cause}"


def test_corners_travel_with_their_samples(tmp_path: Path, scene: HandEyeScene) -> None:
    data = document(scene)
    data |= {
        "camera_matrix": [[800, 0, 320], [0, 800, 240], [0, 0, 1]],
        "target_points_m": [[0, 0, 0], [0.1, 0, 0]],
    }
    for k, sample in enumerate(data["samples"]):
        sample["corners_px"] = [[float(k), 1.0], None if k == 3 else [2.0, 3.0]]
    pairs = load(saved(tmp_path, data))
    for position, name in enumerate(pairs.names):
        assert pairs.corners.pixels[position, 0, 0] == float(name[1:])
        assert np.isnan(pairs.corners.pixels[position, 1]).all() == (name == "s3")
    del data["samples"][1]["corners_px"]
    with pytest.raises(RequestRefused, match="sample s1: corners_px is missing"):
        load(saved(tmp_path, data))


def test_the_documents_example_is_read(tmp_path: Path) -> None:
    text = (DOCS / "hand_eye.md").read_text(encoding="utf-8")
    example = text.split("```json\n")[1].split("```")[0]
    pairs = load(saved(tmp_path, json.loads(example)))
    assert pairs.names == ("pose 1",)
    assert np.isnan(pairs.corners.pixels[0, 2]).all()


def recording(offset_s: float = 0.0) -> tuple[HandEyeScene, Trajectory, Trajectory]:
    """A hand that swings about several axes, seen at 100 Hz by the robot and at 30 Hz by the camera."""
    scene = random_scene(np.random.default_rng(51), 2)

    def hand_at(t: Array) -> Array:
        v = np.stack(
            [0.6 * np.sin(0.9 * t), 0.5 * np.sin(0.7 * t + 1.0), 0.8 * np.sin(0.5 * t + 2.0)], axis=1
        )
        p = np.stack([0.2 * np.cos(0.6 * t), 0.2 * np.sin(0.8 * t), 0.1 * np.sin(0.3 * t)], axis=1)
        return stacks.transform(stacks.exp_so3(v), p)

    t_hand, t_camera = np.arange(0.0, 20.0, 0.01), np.arange(0.5, 19.5, 1.0 / 30.0)
    P = scene._replace(X_BT=hand_at(t_camera)).P()
    return scene, Trajectory(t_hand, hand_at(t_hand)), Trajectory(t_camera - offset_s, P)


def write_tum(path: Path, trajectory: Trajectory, separator: str = " ") -> Path:
    q = stacks.quaternion_from_rotation(trajectory.X[:, :3, :3])[:, [1, 2, 3, 0]]
    rows = np.column_stack([trajectory.time_s, trajectory.X[:, :3, 3], q])
    lines = ["# t x y z qx qy qz qw", *(separator.join(f"{v:.9f}" for v in row) for row in rows)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.mark.parametrize("offset", [0.0, 0.137])
def test_recordings_are_paired_and_their_clocks_aligned(tmp_path: Path, offset: float) -> None:
    scene, hand, camera = recording(offset)
    hand = trajectories.load_tum(write_tum(tmp_path / "hand.tum", hand))
    camera = trajectories.load_tum(write_tum(tmp_path / "camera.csv", camera, ", "))
    pairs, used = trajectories.pair(hand, camera, None)
    assert used == pytest.approx(offset, abs=5e-4)
    assert 10 <= len(pairs) <= 60
    np.testing.assert_allclose(methods.solve(pairs).X, scene.X, atol=2e-3)
    pairs, _ = trajectories.pair(hand, camera, offset)
    np.testing.assert_allclose(methods.solve(pairs).X, scene.X, atol=1e-4)


def test_a_camera_slower_than_its_recording_counts_each_pose_once() -> None:
    scene, hand, camera = recording()
    held = camera._replace(X=camera.X[np.arange(len(camera.X)) // 3 * 3])
    pairs, _ = trajectories.pair(hand, held)
    times = np.array([float(name.removeprefix("t=")) for name in pairs.names])
    assert np.isin(np.round(times, 3), np.round(camera.time_s[::3], 3)).all()
    np.testing.assert_allclose(methods.solve(pairs).X, scene.X, atol=1e-4)


def test_unsorted_and_repeated_times_are_put_right(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    path.write_text("2 0 0 2 0 0 0 1\n0 0 0 0 0 0 0 1\n2 0 0 9 0 0 0 1\n1 0 0 1 0 0 0 1\n", encoding="utf-8")
    found = trajectories.load_tum(path)
    assert found.time_s.tolist() == [0.0, 1.0, 2.0]
    assert found.X[:, 2, 3].tolist() == [0.0, 1.0, 2.0]
    middle = trajectories.interpolated(found, np.array([0.25, 1.5, 2.0]))
    np.testing.assert_allclose(middle[:, 2, 3], [0.25, 1.5, 2.0])


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1 0 0 0 0 0 1", "line 2: 8 numbers are wanted, got 7"),
        ("1 0 0 0 0 0 0 x", "line 2: 'x' is no finite number"),
        ("1 0 0 nan 0 0 0 1", "line 2: 'nan' is no finite number"),
        ("1 0 0 0 0.5 0.5 0 0", "line 2: quaternion has norm 0.707"),
    ],
)
def test_bad_lines_of_a_recording_are_named(tmp_path: Path, line: str, said: str) -> None:
    path = tmp_path / "t.tum"
    path.write_text(f"0 0 0 0 0 0 0 1\n{line}\n2 0 0 0 0 0 0 1\n3 0 0 0 0 0 0 1\n", encoding="utf-8")
    with pytest.raises(RequestRefused, match=said):
        trajectories.load_tum(path)


def test_recordings_that_do_not_belong_together_are_refused() -> None:
    _, hand, camera = recording()
    later = Trajectory(camera.time_s + 100.0, camera.X)
    with pytest.raises(RequestRefused, match="check the clocks"):
        trajectories.pair(hand, later)
    still = Trajectory(camera.time_s, np.repeat(camera.X[:1], len(camera.X), axis=0))
    with pytest.raises(RequestRefused, match="do not turn together") as caught:
        trajectories.pair(hand, still, None)
    assert caught.value.cause == "refused.hand_eye.clocks"
