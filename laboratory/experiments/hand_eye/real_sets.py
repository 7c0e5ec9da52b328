"""`longreach experiment hand-eye --method real-sets`: recordings of real arms, beside the classical methods.

The data are not part of the repository: they are read from ``LONGREACH_DATA``, else from ``../shared/data``
beside the project, and whoever asks for them where they are absent is told so.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from rich.table import Table

import testbed
from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, NoSettings, at_most
from laboratory.experiments.hand_eye.hua import demand_all
from protocol.errors import RequestRefused
from testbed.hand_eye import trajectories
from testbed.hand_eye.importer import ImportOptions, load
from testbed.hand_eye.presentation import HoldOutRow, hold_out, hold_out_table
from vision_pc.config.choices import Method, Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers.methods import CLASSICAL
from vision_pc.core.perception.zhang_intrinsics import Checkerboard
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

OPENCV_BOARD = Checkerboard(9, 6, 0.025)
OPENCV_FX_PX = 535.916  # left_intrinsics.yml, OpenCV's own result
# MoveIt's own test: camera in base, translation m and intrinsic Euler angles XYZ rad, each within 1 %
MOVEIT_TRANSLATION = np.array([0.659, -0.249, 0.830])
MOVEIT_EULER_XYZ = np.array([0.230, -2.540, 1.950])
_BEHIND = 1.02  # of the best classical method's hold-out error
_ETHZ_MM = 1.6


class RealSet(NamedTuple):
    """A campaign's row: the hold-out of all methods on one recording."""

    data: str
    methods: list[Any] | None
    failure: str
    cpu_s: float


Held = Finished[NoSettings, RealSet]


def data_directory() -> Path:
    """Where the recordings are. Raises RequestRefused (``refused.data_absent``) when they are not there."""
    project = Path(testbed.__file__).resolve().parents[1]  # wherever this module lies in it
    default = project.parent / "shared" / "data"
    directory = Path(os.environ.get("LONGREACH_DATA", default))
    if not directory.is_dir():
        raise RequestRefused(
            "refused.data_absent", f"no recordings at {directory}; set LONGREACH_DATA to where they are"
        )
    return directory


def moveit() -> PosePairs:
    """MoveIt's 50 real samples, eye to hand."""
    return load(data_directory() / "moveit" / "pose_samples.json", ImportOptions(setup=Setup.EYE_TO_HAND))


def moveit_reference() -> Array:
    """The camera in the base (4, 4) that MoveIt's own test expects."""
    x, y, z = (stacks.exp_so3(angle * axis) for angle, axis in zip(MOVEIT_EULER_XYZ, np.eye(3), strict=True))
    return stacks.transform(x @ y @ z, MOVEIT_TRANSLATION)


def ethz() -> PosePairs:
    """ETH's simulated arm: hand and camera in the world, at its slowest distinct moments."""
    directory = data_directory() / "ethz_arm_sim"
    hand = trajectories.load_tum(directory / "robot_arm_sim_hand.csv")
    camera = trajectories.load_tum(directory / "robot_arm_sim_camera.csv")
    return trajectories.pair(hand, camera, options=ImportOptions(camera_in_target=True))[0]


def checkerboard_pictures(eye: str = "left") -> list[tuple[str, Image]]:
    """OpenCV's 13 real pictures of a 9×6 board, by file name."""
    files = sorted((data_directory() / "opencv_stereo").glob(f"{eye}??.jpg"))
    if not files:
        raise RequestRefused("refused.data_absent", f"no {eye}??.jpg in {data_directory() / 'opencv_stereo'}")
    return [
        (file.stem, np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)) for file in files
    ]


SETS: dict[str, tuple[Callable[[], PosePairs], Callable[[], Array] | None]] = {
    "moveit": (moveit, moveit_reference),
    "ethz_arm_sim": (ethz, None),
}
"""Name → how it is read, and the published X."""


def set_tasks(request: CampaignRequest, settings: NoSettings) -> list[Task]:
    """One task a recording. Raises RequestRefused where they are absent."""
    data_directory()
    return [{"key": name, "data": name} for name in SETS]


def one_set(task: Task) -> dict[str, Any]:
    """The hold-out of all methods on one recording."""
    pairs, reference = SETS[task["data"]]
    rows = hold_out(task["data"], pairs(), None if reference is None else reference())
    return {"data": task["data"], "methods": [row._asdict() for row in rows]}


def _methods(done: Held) -> dict[str, list[HoldOutRow]]:
    demand_all(done.rows)
    return {row.data: [HoldOutRow(**each) for each in row.methods or ()] for row in done.rows}


def set_verdict(done: Held) -> list[Check]:
    """The published camera, ETH's accuracy, and no more than a fiftieth behind the best classical method."""
    made = _methods(done)
    robust = {data: next(r for r in rows if r.method == Method.ROBUST.value) for data, rows in made.items()}
    off = robust["moveit"].off_mm
    share = 0.1 * (np.inf if off is None else off) / float(np.linalg.norm(MOVEIT_TRANSLATION))
    return [
        at_most("moveit: off the published translation", share, 1.0, "%"),
        at_most("ethz_arm_sim: hold-out", robust["ethz_arm_sim"].hold_out_mm, _ETHZ_MM, "mm"),
        *(check for data, rows in made.items() for check in _beside_classical(data, robust[data], rows)),
    ]


def _beside_classical(data: str, mine: HoldOutRow, rows: list[HoldOutRow]) -> list[Check]:
    """The robust solver's hold-out errors over those of the best classical method, each for itself."""
    names = {method.value for method in CLASSICAL}
    classical = [row for row in rows if row.method in names and row.error is None]
    mm = mine.hold_out_mm / min(row.hold_out_mm for row in classical)
    deg = mine.hold_out_deg / min(row.hold_out_deg for row in classical)
    return [
        at_most(f"{data}: robust over best classical, {unit}", ratio, _BEHIND)
        for unit, ratio in (("mm", mm), ("deg", deg))
    ]


def set_table(done: Held) -> list[Table]:
    """All methods on all recordings."""
    return [hold_out_table([row for rows in _methods(done).values() for row in rows])]


REAL_SETS = Experiment(
    name="hand-eye-real-sets",
    title="Every method on recordings of MoveIt and ETH, two-fold hold-out.",
    settings=NoSettings,
    row=RealSet,
    tasks=set_tasks,
    run=one_set,
    table=set_table,
    verdict=set_verdict,
    world="MoveIt's real arm, ETH's simulated one",
    eyes="their recordings",
    configured=False,
    workers=0,
)
