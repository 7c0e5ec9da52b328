"""`longreach experiment …` of the eye model and the best mode, for the command to mount."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.options import (
    DEFAULT_CONFIG,
    ConfigDir,
    Count,
    Directory,
    JsonFile,
    Scheduler,
    Seed,
    Settings,
)

Harder = Annotated[bool, typer.Option("--harder", help="Scale, drift, lens, print and play errors on top.")]


class Eyes(StrEnum):
    """What vision measures with."""

    PIXELS = "pixels"
    MODEL = "model"


class Arm(StrEnum):
    """Which arm runs."""

    PLANT = "plant"
    LONG_CRANE = "plant_long_crane"
    BOTH = "both"


ChosenEyes = Annotated[Eyes, typer.Option(help="Rendered pictures, or the model measured from them.")]


def register_experiments(experiment: typer.Typer) -> None:
    """Add the commands to ``experiment``."""
    experiment.command("eyes-measure", epilog="Example: longreach experiment eyes-measure --runs 8")(measure)
    experiment.command("eyes-agree", epilog="Example: longreach experiment eyes-agree --runs 30")(agree)
    experiment.command("best-mode", epilog="Example: longreach experiment best-mode --runs 200 --eyes model")(
        best_mode
    )
    experiment.command("path-information", epilog="Example: longreach experiment path-information")(
        path_information
    )
    experiment.command(
        "looking-and-moving", epilog="Example: longreach experiment looking-and-moving --runs 60"
    )(looking_and_moving)


def path_information(
    arm: Annotated[Arm, typer.Option(help="Whose start pose and shape.")] = Arm.PLANT,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    json_file: JsonFile = None,
) -> None:
    """What each candidate calibration path leaves unknown of a goal, from its information matrix."""
    from testbed.experiments.positioning.path_information import run_experiment

    raise typer.Exit(0 if run_experiment(config_dir, arm, json_file) else 1)


def looking_and_moving(
    count: Count = 60,
    seed: Seed = 1,
    harder: Harder = False,
    arm: Annotated[Arm, typer.Option(help="Which arm runs; both: in turn.")] = Arm.PLANT,
    eyes: ChosenEyes = Eyes.MODEL,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    directory: Directory = Path("runs/looking-and-moving"),
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
) -> None:
    """Closed loop at camera rate beside look-then-move; exit status 0 when it ends under 2 mm in 95 %."""
    from testbed.experiments.positioning.corrected import tasks_of
    from testbed.experiments.positioning.visual_servoing import run_experiment

    tasks = tasks_of(seed, count, arm, harder, eyes, settings or [])
    raise typer.Exit(0 if run_experiment(config_dir, tasks, directory, scheduler, json_file) else 1)


def measure(
    count: Count = 8,
    seed: Seed = 1100,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    output: Annotated[Path, typer.Option(help="The file to write.")] = DEFAULT_CONFIG / "eye_model.yaml",
    directory: Directory = Path("runs/eyes-measure"),
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
) -> None:
    """Measure in rendered pictures what the eye model needs, and write its file."""
    from testbed.experiments.positioning.eyes_measure import run_measure

    raise typer.Exit(
        0 if run_measure(config_dir, seed, count, directory, scheduler, output, json_file) else 1
    )


def agree(
    count: Count = 30,
    seed: Seed = 1,
    harder: Harder = False,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    directory: Directory = Path("runs/eyes-agree"),
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
) -> None:
    """The same seeds with pictures and with the eye model; exit status 0 when the errors agree."""
    from testbed.experiments.positioning.eyes_agree import run_experiment

    passed = run_experiment(config_dir, seed, count, harder, directory, scheduler, json_file)
    raise typer.Exit(0 if passed else 1)


def best_mode(
    count: Count = 200,
    seed: Seed = 1,
    harder: Harder = False,
    arm: Annotated[Arm, typer.Option(help="Which arm runs; both: in turn.")] = Arm.PLANT,
    eyes: ChosenEyes = Eyes.MODEL,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    directory: Directory = Path("runs/best-mode"),
    scheduler: Scheduler = None,
    json_file: JsonFile = None,
) -> None:
    """One look, then ±5 mm: drawn scenarios, figures against their limits; exit status 0 when all are met."""
    from testbed.experiments.positioning.corrected import run_experiment, tasks_of

    tasks = tasks_of(seed, count, arm, harder, eyes, settings or [])
    raise typer.Exit(0 if run_experiment(config_dir, tasks, directory, scheduler, json_file) else 1)
