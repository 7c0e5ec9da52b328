"""`longreach hand-eye …`, for the command to mount."""

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.hand_eye_session import app as session
from testbed.cli.options import JsonFile
from vision_pc.core.hand_eye.samples import Setup
from vision_pc.core.hand_eye.solvers.methods import Method
from vision_pc.core.perception.zhang_intrinsics import Detector

app = typer.Typer(help="Hand-eye calibration from files and pictures.", no_args_is_help=True)
app.add_typer(session, name="session")

File = Annotated[Path, typer.Argument(help="Samples (.json, .csv), or the hand's recording (TUM).")]
CameraFile = Annotated[Path | None, typer.Argument(help="The camera's recording (TUM).")]
ChosenSetup = Annotated[Setup | None, typer.Option("--setup", help="Where the camera is mounted.")]
CameraInTarget = Annotated[
    bool, typer.Option("--camera-in-target", help="The camera's poses are of the camera in the target.")
]
Normalise = Annotated[bool, typer.Option("--normalise", help="Accept quaternions of any norm.")]
Offset = Annotated[
    str, typer.Option("--offset-s", help="Seconds to add to the camera's clock, or 'estimate'.")
]
MarkerId = Annotated[int | None, typer.Option("--marker-id", help="Refuse samples of another marker.")]


@app.command(epilog="Example: longreach hand-eye solve samples.json --method robust --json x.json")
def solve(
    file: File,
    camera_file: CameraFile = None,
    method: Annotated[Method, typer.Option(help="Which solver.")] = Method.ROBUST,
    setup: ChosenSetup = None,
    camera_in_target: CameraInTarget = False,
    normalise: Normalise = False,
    offset_s: Offset = "0",
    marker_id: MarkerId = None,
    json_file: JsonFile = None,
) -> None:
    """X from samples, with covariance, residuals, proof and verdict; or the reason why not."""
    from testbed.cli.hand_eye_files import SampleSource, run_solve

    source = SampleSource(file, camera_file, setup, camera_in_target, normalise, offset_s, marker_id)
    run_solve(source, method, json_file)


@app.command(epilog="Example: longreach hand-eye compare hand.tum camera.tum --camera-in-target")
def compare(
    file: File,
    camera_file: CameraFile = None,
    setup: ChosenSetup = None,
    camera_in_target: CameraInTarget = False,
    normalise: Normalise = False,
    offset_s: Offset = "0",
    marker_id: MarkerId = None,
    json_file: JsonFile = None,
) -> None:
    """All methods on the same samples: two-fold hold-out errors."""
    from testbed.cli.hand_eye_files import SampleSource, run_compare

    run_compare(
        SampleSource(file, camera_file, setup, camera_in_target, normalise, offset_s, marker_id), json_file
    )


@app.command(epilog="Example: longreach hand-eye intrinsics left*.jpg --columns 9 --rows 6 --square-mm 25")
def intrinsics(
    pictures: Annotated[list[Path], typer.Argument(help="Pictures of one board, all of one size.")],
    columns: Annotated[int, typer.Option(min=2, help="Inner corners across; squares with --charuco.")] = 8,
    rows: Annotated[int, typer.Option(min=2, help="Inner corners down; squares with --charuco.")] = 6,
    square_mm: Annotated[float, typer.Option(min=0.1, help="Side of a square.")] = 24.0,
    detector: Annotated[Detector, typer.Option(help="How corners are found.")] = Detector.FITTED,
    charuco: Annotated[bool, typer.Option("--charuco", help="The board is a ChArUco board.")] = False,
    marker_mm: Annotated[float, typer.Option(min=0.1, help="Side of a ChArUco board's marker.")] = 18.0,
    dictionary: Annotated[str, typer.Option(help="Its dictionary, as OpenCV names it.")] = "DICT_5X5_100",
    json_file: JsonFile = None,
) -> None:
    """Camera matrix and distortion, errors by view, outlying views and empty parts of the picture."""
    from testbed.cli.hand_eye_files import run_intrinsics_of_pictures
    from vision_pc.core.perception.zhang_intrinsics import Checkerboard

    board = Checkerboard(columns, rows, 1e-3 * square_mm)
    marker = (1e-3 * marker_mm, dictionary) if charuco else None
    run_intrinsics_of_pictures(pictures, board, detector, marker, json_file)


@app.command(epilog="Example: longreach hand-eye drawing configs/cabinet.png")
def drawing(
    file: Annotated[Path, typer.Argument(help="PNG to write.")],
    scenario: Annotated[str, typer.Option(help="Whose cabinet.")] = "hand_eye",
    config_dir: Annotated[Path, typer.Option("--config-dir", help="Configuration.")] = Path("configs"),
) -> None:
    """The emulated cabinet's front as its maker would draw it: what the vision PC is given to find it by."""
    from testbed.cli.hand_eye_files import run_drawing

    run_drawing(file, scenario, config_dir)


@app.command("real-data", epilog="Example: longreach hand-eye real-data --json real.json")
def real_data(json_file: JsonFile = None) -> None:
    """All methods on MoveIt's and ETH's recordings (LONGREACH_DATA names their directory)."""
    from testbed.experiments.hand_eye.experiments import run_real_data

    raise typer.Exit(0 if run_real_data(json_file) else 1)
