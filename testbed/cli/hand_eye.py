"""`longreach hand-eye`: calibration from files, and the guided session on a rig."""

from pathlib import Path
from typing import Annotated

import typer

from foundation.command_options import unfolded
from testbed.cli.options import JsonFile, PicturedBoard, PoseLines, SampleSource
from testbed.cli.root import CommandApp
from testbed.reporting.console import writable
from vision_pc.config.choices import Detector, Method, Setup

session_app = CommandApp(help="Guided hand-eye sampling on a running rig.", no_args_is_help=True)

Url = Annotated[str, typer.Option("--url", help="The vision PC's REST API.", envvar="LONGREACH_URL")]
TokenFile = Annotated[
    Path | None,
    typer.Option(help="File with the token of the role operate.", envvar="LONGREACH_TOKEN_FILE"),
]
DEFAULT_URL = "http://127.0.0.1:8000"


@session_app.callback()
def session(context: typer.Context, token_file: TokenFile = None) -> None:
    """Guided hand-eye sampling on a running rig."""
    context.obj = token_file


@session_app.command(epilog="Example: longreach hand-eye session run monday --poses 17 --json x.json")
def run(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help="The session's name; one that is there goes on.")],
    poses: Annotated[int | None, typer.Option(min=5, max=100, help="Samples wanted.")] = None,
    marker_id: Annotated[int | None, typer.Option(min=0, help="Number of the marker.")] = None,
    marker_mm: Annotated[float | None, typer.Option(min=5.0, help="Its side.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed proposes among the same views.")] = 1,
    url: Url = DEFAULT_URL,
    json_file: JsonFile = None,
) -> None:
    """Take samples until the session is complete, and solve: X with covariance, residuals and verdict.

    Exit status 1 when it is not good enough yet.
    """
    from testbed.hand_eye.session_text import run_session, with_session

    size_m = None if marker_mm is None else 1e-3 * marker_mm
    body = {"name": name, "seed": seed, "poses": poses, "marker_id": marker_id, "marker_size_m": size_m}
    good = with_session(url, context.find_object(Path), lambda client: run_session(client, body, json_file))
    raise typer.Exit(0 if good else 1)


@session_app.command("list", epilog="Example: longreach hand-eye session list --json session.json")
def listing(context: typer.Context, url: Url = DEFAULT_URL, json_file: JsonFile = None) -> None:
    """The open session: every sample with its residual."""
    from testbed.hand_eye.session_text import listed, with_session

    with_session(url, context.find_object(Path), lambda client: listed(client.view(), json_file))


@session_app.command(epilog="Example: longreach hand-eye session remove 3   (then run takes another)")
def remove(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help="The sample's name.")],
    url: Url = DEFAULT_URL,
    json_file: JsonFile = None,
) -> None:
    """Leave a sample out for good."""
    from testbed.hand_eye.session_text import listed, with_session

    with_session(url, context.find_object(Path), lambda client: listed(client.remove(name), json_file))


@session_app.command(
    epilog="Example: longreach hand-eye session export runs/hand-eye/monday.json --out samples.json"
)
def export(
    session: Annotated[Path, typer.Argument(help="A session's file.")],
    samples: Annotated[Path, typer.Option("--out", help="Where its samples go.", callback=writable)],
) -> None:
    """A session's samples as a file for `longreach hand-eye solve` and `compare`."""
    from testbed.hand_eye import session_text

    session_text.exported(session, samples)


app = CommandApp(help="Hand-eye calibration, guided on a rig or from files.", no_args_is_help=True)


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
    pictures: Annotated[list[Path], typer.Argument(help="Of one board, all of one size; or directories.")],
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


app.add_typer(session_app, name="session")
