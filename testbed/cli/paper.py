"""`longreach experiment …`: the paper's tables and figures, the ablation and the sweep."""

from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.options import (
    DEFAULT_CONFIG,
    ConfigDir,
    Count,
    JsonFile,
    Out,
    Scenario,
    Scheduler,
    Seed,
    Settings,
)

Workers = Annotated[int, typer.Option(min=1, max=64, help="How many workers to start.")]


class Eyes(StrEnum):
    """What measures the markers."""

    OPENCV = "opencv"
    PIXELS = "pixels"
    MODEL = "model"


EyesOption = Annotated[
    Eyes,
    typer.Option(
        help="opencv: rendered pictures, markers as in the paper; pixels: rendered pictures, Longreach's "
        "markers; model: no pictures, errors as measured from them."
    ),
]

_PAPER = {
    "table2": "Table 2, the line equation: errors of nine measurements, beside ours.",
    "table3": "Table 3, the match's residuals, beside ours.",
    "table4": "Table 4, trajectory matching: ten measurements of two inputs, beside ours.",
    "fig5": "Figure 5, Euler angles before and after the orientation adjustment.",
    "fig6": "Figure 6, the circle of the line equation.",
    "fig7": "Figure 7, errors over the line equation.",
    "fig8": "Figure 8, the matched trajectories.",
    "fig9": "Figure 9, errors over two inputs after the match.",
}


def add_to(experiment: typer.Typer) -> None:
    """Add the paper's commands to ``experiment``."""
    for name, words in _PAPER.items():
        epilog = f"Example: longreach experiment {name} --runs 20 --seed 1"
        experiment.command(name, help=words, epilog=epilog)(_paper_command((name,)))
    experiment.command(
        "paper",
        help="All tables and figures of Mäkinen et al. 2023 in one report.",
        epilog="Example: longreach experiment paper --runs 100 --seed 1 --out runs/paper",
    )(_paper_command(tuple(_PAPER)))
    experiment.command(epilog="Example: longreach experiment ablation --runs 10 --out runs/paper")(ablation)
    experiment.command(epilog="Example: longreach experiment sweep payload noise --runs 6")(sweep)


def ablation(
    only: Annotated[list[str] | None, typer.Option(help="Only this variant; repeatable.")] = None,
    runs: Count = 10,
    seed: Seed = 1,
    eyes: EyesOption = Eyes.OPENCV,
    scheduler: Scheduler = None,
    workers: Workers = 2,
    directory: Out = Path("runs/paper"),
    scenario: Scenario = "paper",
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """The tables' means with the error sources switched off one at a time."""
    from testbed.experiments.paper.ablation import VARIANTS, run_ablation
    from testbed.experiments.paper.campaign import Asked

    for name in only or []:
        if name not in VARIANTS:
            raise typer.BadParameter(
                f"'{name}'; known: {', '.join(filter(None, VARIANTS))}", param_hint="--only"
            )
    asked = Asked(config_dir, scenario, runs, seed, eyes.value, settings or [], directory, scheduler, workers)
    raise typer.Exit(0 if run_ablation(asked, only or [], json_file) else 1)


def sweep(
    names: Annotated[list[str] | None, typer.Argument(help="Which conditions; none: all.")] = None,
    runs: Count = 6,
    seed: Seed = 1,
    eyes: EyesOption = Eyes.OPENCV,
    scheduler: Scheduler = None,
    workers: Workers = 2,
    directory: Out = Path("runs/paper"),
    scenario: Scenario = "paper",
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    json_file: JsonFile = None,
) -> None:
    """Both methods over payload, mount, distance, noise, texture, play, flexibility and latency."""
    from testbed.experiments.paper.campaign import Asked
    from testbed.experiments.paper.sweep import SWEEPS, run_sweep

    chosen = names or list(SWEEPS)
    for name in chosen:
        if name not in SWEEPS:
            raise typer.BadParameter(f"'{name}'; known: {', '.join(SWEEPS)}", param_hint="NAMES")
    asked = Asked(config_dir, scenario, runs, seed, eyes.value, settings or [], directory, scheduler, workers)
    raise typer.Exit(0 if run_sweep(chosen, asked, json_file) else 1)


def _paper_command(names: tuple[str, ...]) -> Callable[..., None]:
    def command(
        runs: Count = 20,
        seed: Seed = 1,
        eyes: EyesOption = Eyes.OPENCV,
        scheduler: Scheduler = None,
        workers: Workers = 2,
        directory: Out = Path("runs/paper"),
        scenario: Scenario = "paper",
        config_dir: ConfigDir = DEFAULT_CONFIG,
        settings: Settings = None,
        json_file: JsonFile = None,
    ) -> None:
        from testbed.experiments.paper.campaign import Asked, show

        asked = Asked(
            config_dir, scenario, runs, seed, eyes.value, settings or [], directory, scheduler, workers
        )
        raise typer.Exit(0 if show(names, asked, json_file) else 1)

    return command
