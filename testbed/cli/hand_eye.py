"""`longreach hand-eye`: calibration from files, and the guided session on a rig."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from foundation.command_options import unfolded
from testbed.cli.options import DEFAULT_CONFIG, ConfigDir, JsonFile, PicturedBoard, PoseLines, SampleSource
from testbed.cli.root import CommandApp
from testbed.reporting.console import writable
from vision_pc.config.choices import Detector, Method, Setup

session_app = CommandApp(
    help="Guided hand-eye sampling on a running rig, step by step.", no_args_is_help=True
)

JSON = dict[str, Any]
Url = Annotated[str, typer.Option("--url", help="The vision PC's REST face.", envvar="LONGREACH_URL")]
Name = Annotated[str, typer.Argument(help="The session's name.")]
SampleName = Annotated[str, typer.Argument(help="The sample's name.")]
SessionJson = Annotated[
    Path | None, typer.Option("--json", help="Also write every printed figure to this file.")
]
Anywhere = Annotated[
    bool, typer.Option("--random", help="Any pose that keeps the bounds, not the most informative one.")
]
DEFAULT_URL = "http://127.0.0.1:8000"


@session_app.callback()
def session(
    context: typer.Context,
    token_file: Annotated[
        Path | None,
        typer.Option(help="File with the token of the role operate.", envvar="LONGREACH_TOKEN_FILE"),
    ] = None,
) -> None:
    """Guided hand-eye sampling on a running rig, step by step."""
    context.obj = token_file


def _do(context: typer.Context, url: str, act: Callable[[Any], None]) -> None:
    from testbed.hand_eye.session_text import with_session

    with_session(url, context.find_object(Path), act)


@session_app.command(epilog="Example: longreach hand-eye session start monday --poses 17")
def start(
    context: typer.Context,
    name: Name,
    poses: Annotated[int | None, typer.Option(min=5, max=100, help="Samples wanted.")] = None,
    marker_id: Annotated[int | None, typer.Option(min=0, help="Number of the marker.")] = None,
    marker_mm: Annotated[float | None, typer.Option(min=5.0, help="Its side.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed proposes among the same views.")] = 1,
    url: Url = DEFAULT_URL,
    json_file: SessionJson = None,
) -> None:
    """Check the starting pose and open a session there: 0/17."""
    from testbed.hand_eye import session_text

    body: JSON = {"name": name, "seed": seed, "poses": poses, "marker_id": marker_id}
    body["marker_size_m"] = None if marker_mm is None else 1e-3 * marker_mm
    given = {key: value for key, value in body.items() if value is not None}
    _do(
        context,
        url,
        lambda face: session_text.started(face.step("start", given, "checking the starting pose"), json_file),
    )


@session_app.command(epilog="Example: longreach hand-eye session propose")
def propose(
    context: typer.Context, url: Url = DEFAULT_URL, anywhere: Anywhere = False, json_file: SessionJson = None
) -> None:
    """The next pose: the one that tells most about the camera's place in the hand."""
    from testbed.hand_eye import session_text

    _do(context, url, lambda face: session_text.proposed(face.propose(not anywhere), json_file))


@session_app.command(epilog="Example: longreach hand-eye session go")
def go(context: typer.Context, url: Url = DEFAULT_URL, json_file: SessionJson = None) -> None:
    """Drive to the proposed pose and wait until the arm has settled; the controller may refuse it."""
    from testbed.hand_eye import session_text

    _do(context, url, lambda face: session_text.gone(face.step("go", {}, "moving"), json_file))


@session_app.command("next", epilog="Example: longreach hand-eye session next")
def following(
    context: typer.Context, url: Url = DEFAULT_URL, anywhere: Anywhere = False, json_file: SessionJson = None
) -> None:
    """Propose and go, until the controller accepts a pose."""
    from testbed.hand_eye import session_text

    def act(face: Any) -> None:
        done = face.step("next", {"informative": not anywhere}, "moving to the next pose")
        session_text.proposed(done, None)
        session_text.gone(done, json_file)

    _do(context, url, act)


@session_app.command(epilog="Example: longreach hand-eye session back")
def back(context: typer.Context, url: Url = DEFAULT_URL, json_file: SessionJson = None) -> None:
    """Drive back to the starting pose, over the samples where the straight way is refused."""
    from testbed.hand_eye import session_text

    _do(context, url, lambda face: session_text.gone(face.step("back", {}, "moving back"), json_file))


@session_app.command(epilog="Example: longreach hand-eye session sample")
def sample(context: typer.Context, url: Url = DEFAULT_URL, json_file: SessionJson = None) -> None:
    """Take a sample where the arm stands."""
    from testbed.hand_eye import session_text

    _do(
        context, url, lambda face: session_text.sampled(face.step("sample", {}, "taking a sample"), json_file)
    )


@session_app.command(epilog="Example: longreach hand-eye session run   (takes what is missing, then solve)")
def run(context: typer.Context, url: Url = DEFAULT_URL, anywhere: Anywhere = False) -> None:
    """Take samples until the session is complete: sample, next, sample, next, …"""
    from testbed.hand_eye import session_text

    def act(face: Any) -> None:
        view = face.view()
        while not view["complete"]:
            if view["samples"]:
                face.step("next", {"informative": not anywhere}, "moving to the next pose")
            session_text.sampled(face.step("sample", {}, "taking a sample"), None)
            view = face.view()
        session_text.listed(view, None)

    _do(context, url, act)


@session_app.command("list", epilog="Example: longreach hand-eye session list --json session.json")
def listing(context: typer.Context, url: Url = DEFAULT_URL, json_file: SessionJson = None) -> None:
    """The open session: every sample with its residual."""
    from testbed.hand_eye import session_text

    _do(context, url, lambda face: session_text.listed(face.view(), json_file))


@session_app.command(epilog="Example: longreach hand-eye session remove 3")
def remove(
    context: typer.Context, name: SampleName, url: Url = DEFAULT_URL, json_file: SessionJson = None
) -> None:
    """Leave a sample out for good."""
    from testbed.hand_eye import session_text

    _do(context, url, lambda face: session_text.listed(face.remove(name), json_file))


@session_app.command(epilog="Example: longreach hand-eye session redo 3")
def redo(
    context: typer.Context, name: SampleName, url: Url = DEFAULT_URL, json_file: SessionJson = None
) -> None:
    """Drive back to a sample's pose and take it again."""
    from testbed.hand_eye import session_text

    _do(
        context,
        url,
        lambda face: session_text.sampled(
            face.step("redo", {"sample": name}, f"sample {name} again"), json_file
        ),
    )


@session_app.command("solve", epilog="Example: longreach hand-eye session solve --json x.json")
def solve_session(context: typer.Context, url: Url = DEFAULT_URL, json_file: SessionJson = None) -> None:
    """X with covariance, residuals, proof and verdict; exit status 1 when it is not good enough yet."""
    from testbed.hand_eye import session_text

    verdicts: list[bool] = []
    _do(
        context,
        url,
        lambda face: verdicts.append(session_text.solved(face.step("solve", {}, "solving"), json_file)),
    )
    raise typer.Exit(0 if verdicts[0] else 1)


@session_app.command(epilog="Example: longreach hand-eye session locate   (after solve)")
def locate(context: typer.Context, url: Url = DEFAULT_URL, json_file: SessionJson = None) -> None:
    """The control cabinet's knob, switch and key hole in hand and base."""
    from testbed.hand_eye import session_text

    _do(
        context,
        url,
        lambda face: session_text.located(face.step("locate", {}, "looking at the cabinet"), json_file),
    )


@session_app.command(epilog="Example: longreach hand-eye session resume monday")
def resume(
    context: typer.Context,
    name: Annotated[str | None, typer.Argument(help="The session's name; none: list them.")] = None,
    url: Url = DEFAULT_URL,
    json_file: SessionJson = None,
) -> None:
    """Open a session from the vision PC's disk."""
    from testbed.hand_eye import session_text

    def act(face: Any) -> None:
        if name is None:
            session_text.named(face.names())
        else:
            session_text.listed(face.resume(name), json_file)

    _do(context, url, act)


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
    file: Annotated[Path, typer.Option("--out", help="Where the PNG goes.", callback=writable)],
    scenario: Annotated[str, typer.Option(help="Whose cabinet.")] = "hand_eye",
    config_dir: ConfigDir = DEFAULT_CONFIG,
) -> None:
    """The emulated cabinet's front as its maker would draw it: what the vision PC is given to find it by."""
    from testbed.cli.hand_eye_files import run_drawing

    run_drawing(file, scenario, config_dir)


app.add_typer(session_app, name="session")
