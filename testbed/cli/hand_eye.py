"""`longreach hand-eye …`, for the command to mount."""

from pathlib import Path
from typing import Annotated

import typer

from foundation.command_options import unfolded
from testbed.cli.hand_eye_session import app as session
from testbed.cli.options import DEFAULT_CONFIG, ConfigDir, JsonFile, PicturedBoard, PoseLines, SampleSource
from testbed.reporting.console import writable
from vision_pc.config.choices import Detector, Method, Setup

app = typer.Typer(help="Hand-eye calibration, guided on a rig or from files.", no_args_is_help=True)
app.add_typer(session, name="session")


@app.command(epilog="Example: longreach hand-eye solve samples.json --method robust --json x.json")
@unfolded
def solve(
    source: SampleSource,
    method: Annotated[Method, typer.Option(help="Which solver.")] = Method.ROBUST,
    as_given: Annotated[
        bool, typer.Option("--as-given", help="Only tell what would have refused the samples.")
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """X from samples, with covariance, residuals, proof and verdict; or the reason why not.

    Exit status 1 when the verdict is questioned.
    """
    from testbed.cli.hand_eye_files import run_solve

    raise typer.Exit(0 if run_solve(source, method, as_given, json_file) else 1)


@app.command(epilog="Example: longreach hand-eye compare hand.tum camera.tum --camera-in-target")
@unfolded
def compare(source: SampleSource, json_file: JsonFile = None) -> None:
    """All methods on the same samples: two-fold hold-out errors."""
    from testbed.cli.hand_eye_files import run_compare

    run_compare(source, json_file)


@app.command(epilog="Example: longreach hand-eye intrinsics left*.jpg --columns 9 --rows 6 --square-mm 25")
@unfolded
def intrinsics(
    pictures: Annotated[list[Path], typer.Argument(help="Pictures of one board, all of one size.")],
    board: PicturedBoard,
    detector: Annotated[Detector, typer.Option(help="How corners are found.")] = Detector.FITTED,
    json_file: JsonFile = None,
) -> None:
    """Camera matrix and distortion, errors by view, outlying views and empty parts of the picture."""
    from testbed.cli.hand_eye_files import run_intrinsics_of_pictures

    run_intrinsics_of_pictures(pictures, board, detector, json_file)


@app.command(
    "samples",
    epilog="Example: longreach hand-eye samples pictures poses.csv --poses kuka --camera camera.yaml",
)
@unfolded
def samples_of_pictures(
    pictures: Annotated[Path, typer.Argument(help="Directory of pictures of the board.")],
    poses: Annotated[Path, typer.Argument(help="The hand in the base, a line a picture.")],
    camera: Annotated[
        Path, typer.Option(help="Of `camera calibrate` (its left eye), or JSON of `hand-eye intrinsics`.")
    ],
    board: PicturedBoard,
    form: PoseLines,
    setup: Annotated[Setup, typer.Option(help="Where the camera is mounted.")] = Setup.EYE_IN_HAND,
    to: Annotated[Path, typer.Option("--out", help="The file to write.", callback=writable)] = Path(
        "samples.json"
    ),
) -> None:
    """The samples that `solve` reads, from pictures of a board and the robot's poses."""
    from testbed.cli.hand_eye_files import run_samples

    run_samples((pictures, poses, camera), board, form, setup, to)


@app.command(epilog="Example: longreach hand-eye drawing --out configs/cabinet.png")
def drawing(
    file: Annotated[Path, typer.Option("--out", help="Where the PNG goes.")],
    scenario: Annotated[str, typer.Option(help="Whose cabinet.")] = "hand_eye",
    config_dir: ConfigDir = DEFAULT_CONFIG,
) -> None:
    """The emulated cabinet's front as its maker would draw it: what the vision PC is given to find it by."""
    from testbed.cli.hand_eye_files import run_drawing

    run_drawing(file, scenario, config_dir)
