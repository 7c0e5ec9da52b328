"""`longreach camera`: put a stereo camera into service: check it, calibrate it, convert others' files."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from foundation.command_options import unfolded
from testbed.cli.options import DEFAULT_CONFIG, ConfigDir, JsonFile, PicturedBoard, Seed, Settings
from testbed.cli.root import CommandApp
from testbed.reporting.console import writable
from vision_pc.config.choices import LensModel

if TYPE_CHECKING:
    from vision_pc.config.vision import VisionConfig

app = CommandApp(help="A stereo camera: check, calibrate, convert.", no_args_is_help=True)

Source = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE",
        help="live (as vision.camera says), a device's number, a side-by-side film, or a directory of pairs.",
    ),
]
Out = Annotated[Path, typer.Option("--out", help="Where the calibration goes.", callback=writable)]
Size = Annotated[str | None, typer.Option(help="One eye's picture, WIDTHxHEIGHT.")]


def _vision(config_dir: Path, settings: list[str] | None) -> "VisionConfig":
    from foundation.configuration import load, parse_overrides
    from vision_pc.config.vision import VisionConfig

    return load(VisionConfig, config_dir / "vision.yaml", parse_overrides(settings or []).get("vision"))


@app.command(epilog="Example: longreach camera check live --set vision.camera.calibration=camera.yaml")
@unfolded
def check(
    source: Source,
    board: PicturedBoard,
    with_board: Annotated[
        bool, typer.Option("--board", help="A board is in view: its squares tell the disparity's offset.")
    ] = False,
    pairs: Annotated[int, typer.Option(min=1, help="How many pairs are looked at.")] = 20,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """Rows, disparity, size, rate, stamps, sharpness and exposure; exit status 1 when something is bad."""
    from testbed.camera.checking import run_check
    from testbed.cli.boards import described_board

    pattern = described_board(board) if with_board else None
    raise typer.Exit(0 if run_check(source, _vision(config_dir, settings), pairs, pattern, json_file) else 1)


@app.command(
    epilog="Example: longreach camera calibrate boards --columns 9 --rows 6 --square-mm 25 --out camera.yaml"
)
@unfolded
def calibrate(
    source: Source,
    board: PicturedBoard,
    to: Out = Path("camera.yaml"),
    lens: Annotated[LensModel, typer.Option(help="How the lenses bend rays.")] = LensModel.BROWN_CONRADY,
    pairs: Annotated[int, typer.Option(min=1, help="At most so many pairs, evenly over all.")] = 60,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """Calibrate raw pairs of one board, held everywhere in both pictures, tilted and at several distances."""
    from testbed.camera.calibrating import run_calibrate
    from testbed.cli.boards import described_board

    pattern, vision = described_board(board), _vision(config_dir, settings)
    good = run_calibrate(source, vision.camera, pattern, lens, pairs, to, json_file)
    raise typer.Exit(0 if good else 1)


@app.command(epilog="Example: longreach camera convert SN12345.conf --size 1280x720 --out camera.yaml")
def convert(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="One file, or left and right.")],
    to: Out = Path("camera.yaml"),
    size: Size = None,
    length_mm: Annotated[float, typer.Option(min=1e-6, help="Unit of OpenCV's T.")] = 1000.0,
) -> None:
    """Read a ZED's, Kalibr's, ROS's or OpenCV's calibration and write our own."""
    from testbed.camera.calibrating import run_convert

    run_convert(files, _size(size), length_mm, to)


@app.command(epilog="Example: longreach camera emulate --out boards.avi --seed 3")
@unfolded
def emulate(
    board: PicturedBoard,
    to: Annotated[Path, typer.Option("--out", help="A directory, or a film that ends in .avi.")],
    pairs: Annotated[int, typer.Option(min=1, help="How many pairs.")] = 24,
    markers: Annotated[
        bool, typer.Option("--markers", help="The scene's markers, as the arm shows them, and no board.")
    ] = False,
    scenario: Annotated[str, typer.Option(help="Whose camera.")] = "raw_camera",
    seed: Seed = 1,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
) -> None:
    """Pairs of a board, or of the markers, as the emulator's raw camera takes them."""
    from testbed.camera.pairs import run_emulate
    from testbed.cli.boards import described_board
    from testbed.scenarios.scenario import chosen_overrides, load_settings

    overrides = chosen_overrides(config_dir, scenario, seed, settings or [])
    pattern = None if markers else described_board(board)
    run_emulate(load_settings(config_dir, overrides).scene, pattern, pairs, seed, to)


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise typer.BadParameter(f"{text}: WIDTHxHEIGHT is wanted, such as 1280x720", param_hint="--size")
    return int(width), int(height)
