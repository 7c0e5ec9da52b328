"""What `longreach hand-eye` is asked for: where samples come from, and what board was pictured."""

from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from testbed.hand_eye.pose_forms import PoseForm
from vision_pc.config.choices import Setup


class SampleSource(NamedTuple):
    """Where samples come from."""

    file: Annotated[Path, typer.Argument(help="Samples (.json, .csv), or the hand's recording (TUM).")]
    camera_file: Annotated[Path | None, typer.Argument(help="The camera's recording (TUM).")] = None
    setup: Annotated[Setup | None, typer.Option("--setup", help="Where the camera is mounted.")] = None
    camera_in_target: Annotated[
        bool, typer.Option("--camera-in-target", help="The camera's poses are of the camera in the target.")
    ] = False
    normalise: Annotated[bool, typer.Option("--normalise", help="Accept quaternions of any norm.")] = False
    offset_s: Annotated[
        str, typer.Option("--offset-s", help="Seconds to add to the camera's clock, or 'estimate'.")
    ] = "0"
    marker_id: Annotated[
        int | None, typer.Option("--marker-id", help="Refuse samples of another marker.")
    ] = None


class PicturedBoard(NamedTuple):
    """The board in the pictures."""

    columns: Annotated[int, typer.Option(min=2, help="Inner corners across; squares with --charuco.")] = 9
    rows: Annotated[int, typer.Option(min=2, help="Inner corners down; squares with --charuco.")] = 6
    square_mm: Annotated[float, typer.Option(min=0.1, help="Side of a square.")] = 25.0
    charuco: Annotated[bool, typer.Option("--charuco", help="The board is a ChArUco board.")] = False
    marker_mm: Annotated[float, typer.Option(min=0.1, help="Side of a ChArUco board's marker.")] = 18.0
    dictionary: Annotated[str, typer.Option(help="Its dictionary, as OpenCV names it.")] = "DICT_5X5_100"


class PoseLines(NamedTuple):
    """How the robot's poses are written."""

    poses_as: Annotated[PoseForm, typer.Option("--poses", help="Whose way of writing poses.")] = (
        PoseForm.QUATERNION_XYZW
    )
    euler: Annotated[
        str, typer.Option(help="Order of Euler angles: ZYX about turned axes, zyx about fixed ones.")
    ] = "ZYX"
    hand_unit: Annotated[
        str | None, typer.Option(help="m, cm or mm; by default mm of kuka and abb, else m.")
    ] = None
