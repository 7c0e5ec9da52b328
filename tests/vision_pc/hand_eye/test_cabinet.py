"""Knob, switch and key hole located in emulated stereo pairs, against where they truly are."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from foundation.configuration import load
from plant_emulator.core.camera.cabinet import board_pose
from protocol.errors import MeasurementFailed
from tests.plant_emulator.camera.board_points import board_points
from tests.vision_pc.hand_eye.still_rig import CONFIGS, X_BT_START, StillRig, still_settings
from vision_pc.application.hand_eye.steps import load_drawing
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.hand_eye.guided import cabinet
from vision_pc.core.hand_eye.guided.cabinet import CabinetLocator, Drawing
from vision_pc.core.perception import intrinsics
from vision_pc.core.types import CameraCalibration, StereoPair

EXACT = {  # a camera that is as vision believes
    "camera": {
        "lens": {"fx_px": 530.0, "fy_px": 530.0, "cx_px": 639.5, "cy_px": 359.5,
                 "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0},
        "baseline_m": 0.12,
        "rectification": {"vertical_px": 0.0, "disparity_px": 0.0, "right_eye_rotation_deg": [0.0, 0.0, 0.0]},
    }
}  # fmt: skip


def drawing() -> Drawing:
    """The shipped drawing with its targets."""
    return load_drawing(still_settings().vision.cabinet)


@pytest.mark.parametrize("arm", ["", "arms/long_crane"])
def test_the_drawing_is_found_from_every_directory_and_for_every_arm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arm: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert (
        load_drawing(load(VisionConfig, CONFIGS / arm / "vision.yaml").cabinet).picture.shape
        == drawing().picture.shape
    )


async def seen(
    tmp_path: Path, turn_deg: tuple[float, float, float]
) -> tuple[StereoPair, CameraCalibration, np.ndarray]:
    """A pair with the hand turned from its start, the camera, and the targets' true places in C."""
    rig = StillRig(still_settings(scene=EXACT), tmp_path)
    turn = se3.transform(se3.exp_so3(np.radians(turn_deg)), np.zeros(3))
    await rig.move_to(X_BT_START @ turn)
    pair = (await rig.pairs_at_rest(1)).pairs[0]
    board = rig.settings.scene.boards[1]
    X_WC = rig.scene.mounts.X_WB @ rig.X_BT_true @ rig.X_TC
    X_CP = se3.inverse(X_WC) @ rig.scene.mounts.X_WO @ board_pose(board)
    return pair, intrinsics.calibration(rig.settings.vision.camera), se3.apply(X_CP, board_points(board))


@pytest.mark.parametrize("turn_deg", [(0.0, 0.0, 0.0), (8.0, 5.0, -10.0), (-6.0, 8.0, 12.0)])
async def test_targets_are_located_to_half_a_millimetre(
    tmp_path: Path, turn_deg: tuple[float, float, float]
) -> None:
    pair, camera, true = await seen(tmp_path, turn_deg)
    for target, place in zip(CabinetLocator(drawing()).locate(pair, camera), true, strict=True):
        assert np.abs(target.p_C - place)[:2].max() < 0.2e-3
        assert abs(target.p_C[2] - place[2]) < 0.8e-3
        assert target.gap_px < 0.1


async def test_a_hidden_target_is_named(tmp_path: Path) -> None:
    pair, camera, true = await seen(tmp_path, (0.0, 0.0, 0.0))
    u, v = intrinsics.project(camera.right, true[2:3])[0].round().astype(int)
    pair.right[v - 30 : v + 31, u - 30 : u + 31] = 90
    with pytest.raises(MeasurementFailed, match="key hole") as refused:
        CabinetLocator(drawing()).locate(pair, camera)
    assert refused.value.cause == "measurement.hand_eye.target_not_seen"


async def test_a_target_in_the_wrong_place_is_refused(tmp_path: Path) -> None:
    pair, camera, _ = await seen(tmp_path, (0.0, 0.0, 0.0))
    honest = drawing()
    knob, *others = honest.targets
    found = CabinetLocator(honest).locate(pair, camera)
    moved = (found[0]._replace(p_C=found[0].p_C + np.array([0.01, 0.0, 0.0])), *found[1:])
    with pytest.raises(MeasurementFailed, match=r"knob: .* mm nearer to or farther") as refused:
        cabinet._refuse_strangers(moved, honest._replace(targets=(knob, *others)))
    assert refused.value.cause == "measurement.hand_eye.target_not_seen"


async def test_a_locator_knows_its_own_drawing_alone(tmp_path: Path) -> None:
    """Not that of another one whose picture lay in the same memory."""
    pair, camera, _ = await seen(tmp_path, (0.0, 0.0, 0.0))
    drawn = drawing()
    first = CabinetLocator(drawn)
    found = first.locate(pair, camera)
    drawn.picture[:] = 127
    with pytest.raises(MeasurementFailed, match="0 features of the cabinet's drawing"):
        CabinetLocator(drawn).locate(pair, camera)
    drawn.picture[:] = drawing().picture
    again = first.locate(pair, camera)
    assert [t.p_C.tolist() for t in again] == [t.p_C.tolist() for t in found]


def test_a_bare_wall_shows_no_cabinet(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    wall = cv2.GaussianBlur(rng.integers(0, 255, (720, 1280), dtype=np.uint8), (0, 0), 2.0)
    pair = StereoPair(np.asarray(wall, dtype=np.uint8), np.asarray(wall, dtype=np.uint8), 0, 0)
    camera = intrinsics.calibration(still_settings().vision.camera)
    with pytest.raises(MeasurementFailed, match="features of the cabinet's drawing") as refused:
        CabinetLocator(drawing()).locate(pair, camera)
    assert refused.value.cause == "measurement.hand_eye.cabinet_not_seen"
