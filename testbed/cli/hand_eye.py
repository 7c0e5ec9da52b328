"""`longreach hand-eye …` and the experiments of Hua et al. 2024, for the command to mount."""

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.hand_eye_session import app as session
from testbed.experiments.hand_eye.noise_sweep import NoiseOn
from vision_pc.core.hand_eye.samples import Setup
from vision_pc.core.hand_eye.solvers.methods import Method
from vision_pc.core.perception.zhang_intrinsics import Detector

app = typer.Typer(help="Hand-eye calibration from files and pictures.", no_args_is_help=True)
app.add_typer(session, name="session")

JsonFile = Annotated[
    Path | None, typer.Option("--json", help="Also write every printed figure to this file.")
]
Plot = Annotated[Path | None, typer.Option("--plot", help="Also draw the figure, as PNG.")]
Directory = Annotated[Path, typer.Option(help="Where rows are kept; the same one resumes.")]
Scheduler = Annotated[
    str | None, typer.Option(help="A Dask scheduler, such as tcp://host:8786; none: this machine.")
]
Seed = Annotated[int, typer.Option(min=0, help="The same seed is the same noise.")]
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
    from testbed.cli.hand_eye_files import Source, run_solve

    source = Source(file, camera_file, setup, camera_in_target, normalise, offset_s, marker_id)
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
    from testbed.cli.hand_eye_files import Source, run_compare

    run_compare(Source(file, camera_file, setup, camera_in_target, normalise, offset_s, marker_id), json_file)


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


def hua_fig5(
    runs: Annotated[int, typer.Option(min=1, help="How many calibrations.")] = 50,
    repetitions: Annotated[int, typer.Option(min=1, help="Localisations of each task.")] = 50,
    seed: Seed = 1,
    plot: Plot = None,
    json_file: JsonFile = None,
    directory: Directory = Path("runs/hua-fig5"),
    scheduler: Scheduler = None,
) -> None:
    """Localisation of knob, switch and key hole with every method, beside the paper's errors and rates."""
    from testbed.experiments.hand_eye.experiments import run_localisation

    raise typer.Exit(
        0 if run_localisation(runs, repetitions, seed, plot, json_file, directory, scheduler) else 1
    )


def hua_fig7(
    noise_on: Annotated[NoiseOn, typer.Option(help="What is noisy.")] = NoiseOn.CAMERA_POSES,
    runs: Annotated[int, typer.Option(min=1, help="How many runs at each level.")] = 200,
    largest: Annotated[int, typer.Option(min=1, help="Levels d = 1 … this.")] = 10,
    seed: Seed = 1,
    plot: Plot = None,
    json_file: JsonFile = None,
    directory: Directory = Path("runs/hua-fig7"),
    scheduler: Scheduler = None,
) -> None:
    """Error of X against the noise level, every method, with the Cramér-Rao bound."""
    from testbed.experiments.hand_eye.experiments import run_noise_sweep

    passed = run_noise_sweep(noise_on, runs, largest, seed, plot, json_file, directory, scheduler)
    raise typer.Exit(0 if passed else 1)


def hua_intrinsics(
    runs: Annotated[int, typer.Option(min=1, help="How many calibrations.")] = 2,
    views: Annotated[int, typer.Option(min=3, help="Pictures of each.")] = 15,
    seed: Seed = 1,
    plot: Plot = None,
    json_file: JsonFile = None,
    directory: Directory = Path("runs/hua-intrinsics"),
    scheduler: Scheduler = None,
) -> None:
    """Zhang's method on boards that the emulator shows the paper's camera, and on OpenCV's real pictures."""
    from testbed.experiments.hand_eye.experiments import run_intrinsics

    raise typer.Exit(0 if run_intrinsics(runs, views, seed, plot, json_file, directory, scheduler) else 1)


def hand_eye_stress(
    runs: Annotated[int, typer.Option(min=1, help="How many runs of each scenario.")] = 200,
    seed: Seed = 1,
    json_file: JsonFile = None,
    directory: Directory = Path("runs/hand-eye-stress"),
    scheduler: Scheduler = None,
) -> None:
    """Two bad samples of fifteen, and rotations under 5°, with every method."""
    from testbed.experiments.hand_eye.experiments import run_stress

    raise typer.Exit(0 if run_stress(runs, seed, json_file, directory, scheduler) else 1)


def hand_eye_guided(
    runs: Annotated[int, typer.Option(min=1, help="How many worlds, from --seed on.")] = 10,
    seed: Seed = 301,
    repetitions: Annotated[int, typer.Option(min=0, help="Poses from which the targets are located.")] = 50,
    against_random: Annotated[bool, typer.Option(help="Also take samples at random poses.")] = True,
    scenario: Annotated[str, typer.Option(help="What the worlds are drawn from.")] = "hand_eye",
    config_dir: Annotated[Path, typer.Option("--config-dir", help="Configuration.")] = Path("configs"),
    directory: Directory = Path("runs/hand-eye-guided"),
    scheduler: Scheduler = None,
    plot: Plot = None,
    json_file: JsonFile = None,
) -> None:
    """Guided sessions on the emulated arm: error of X, its covariance, samples needed, located targets."""
    from testbed.experiments.hand_eye.guided_campaign import run_guided
    from testbed.experiments.hand_eye.guided_experiment import Choice

    choice = Choice(str(config_dir), scenario, repetitions, against_random)
    raise typer.Exit(0 if run_guided(choice, runs, seed, directory, scheduler, plot, json_file) else 1)


def register_experiments(experiment: typer.Typer) -> None:
    """Add the four experiments of the paper and the stress test to ``longreach experiment``."""
    example = "Example: longreach experiment {} --runs 20 --json {}.json"
    for name, function in (
        ("hua-fig5", hua_fig5),
        ("hua-fig6", hua_fig5),  # the same localisations: Fig. 5 their error, Fig. 6 their rate
        ("hua-fig7", hua_fig7),
        ("hua-intrinsics", hua_intrinsics),
        ("hand-eye-stress", hand_eye_stress),
        ("hand-eye-guided", hand_eye_guided),
    ):
        experiment.command(name, epilog=example.format(name, name))(function)
