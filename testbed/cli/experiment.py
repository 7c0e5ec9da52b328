"""`longreach experiment NAME`: one command for every experiment of the catalogue."""

import inspect
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from foundation.command_options import options_of, with_signature
from testbed.campaigns.campaign import CampaignRequest
from testbed.campaigns.experiment import Experiment, perform
from testbed.cli.every_command import dressed
from testbed.cli.options import DEFAULT_CONFIG, ConfigDir, JsonFile
from testbed.experiments.catalogue import CATALOGUE, Entry
from testbed.reporting.console import out, table, writable

Count = Annotated[int | None, typer.Option("--count", min=1, help="How many seeds, from --seed on.")]
Seed = Annotated[int, typer.Option(min=0, help="The same seed is the same world; the first of several.")]
Out = Annotated[
    Path | None,
    typer.Option("--out", help="Rows and pictures; rows that are there are not measured again."),
]
Fresh = Annotated[bool, typer.Option("--fresh", help="Measure all rows anew, also those that are there.")]
Workers = Annotated[
    int, typer.Option(min=0, max=64, help="How many workers to start; 0: run in this process.")
]
Scheduler = Annotated[
    str | None,
    typer.Option(help="A Dask scheduler that is there, such as tcp://host:8786; else workers are started."),
]
Plot = Annotated[
    Path | None, typer.Option("--plot", help="Write the picture to this file.", callback=writable)
]


class ExperimentGroup(TyperGroup):
    """The catalogue's experiments as commands; one is loaded when it is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names: ``list``, then the experiments."""
        return ["list", *CATALOGUE]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command called ``cmd_name``; None where there is none."""
        if cmd_name not in CATALOGUE:
            return super().get_command(ctx, cmd_name)
        return dressed(typer.main.get_command(_app_of(CATALOGUE[cmd_name], cmd_name)))


app = typer.Typer(cls=ExperimentGroup, help="Seeded experiments that write tables.", no_args_is_help=True)


@app.callback()
def experiment() -> None:
    """Seeded experiments that write tables."""


@app.command("list")
def list_experiments() -> None:
    """All experiments: what each shows, how many runs it makes by default, and what a run costs."""
    cells = []
    for name, entry in CATALOGUE.items():
        chosen = entry.load()
        cells.append((name, chosen.shows, chosen.runs or "–", chosen.cost))
    out.print(table("experiments", ("longreach experiment", "shows", "runs", "a run costs"), cells))


def _app_of(entry: Entry, name: str) -> typer.Typer:
    made = typer.Typer(add_completion=False)
    example = f"Example: longreach experiment {name} --json {name}.json"
    made.command(name, help=entry.load().shows, epilog=example)(command_of(entry))
    return made


def command_of(entry: Entry) -> Callable[..., None]:
    """The function behind a command: its options are the request's and the experiment's own settings."""
    usual = entry.load()

    def command(**options: Any) -> None:
        wanted = entry.load(options.pop("method", None))
        request = CampaignRequest(
            config_dir=options.pop("config_dir"),
            runs=options.pop("count", None) or wanted.runs,
            seed=options.pop("seed", wanted.seed),
            out=options.pop("out") or wanted.directory,
            scheduler=options.pop("scheduler"),
            workers=options.pop("workers"),
            fresh=options.pop("fresh"),
            json=options.pop("json_file"),
            plot=options.pop("plot"),
        )
        raise typer.Exit(0 if perform(wanted, request, wanted.settings(**options)) else 1)

    parameters = [*options_of(usual.settings), *_method(entry), *_common(usual, len(entry.places) == 1)]
    with_signature(command, parameters)
    return command


def _method(entry: Entry) -> list[inspect.Parameter]:
    if len(entry.places) == 1:
        return []
    methods = StrEnum("Method", {name: name for name in entry.places})  # type: ignore[misc]
    kind = Annotated[methods, typer.Option(help="Which method.")]
    return [_parameter("method", kind, next(iter(methods)))]


def _common(chosen: Experiment[Any, Any], alone: bool) -> list[inspect.Parameter]:
    counted = [
        _parameter("count", Count, chosen.runs if alone else None),
        _parameter("seed", Seed, chosen.seed),
    ]
    return [
        *(counted if chosen.runs else []),
        _parameter("out", Out, chosen.directory if alone else None),
        _parameter("fresh", Fresh, False),
        _parameter("scheduler", Scheduler, None),
        _parameter("workers", Workers, chosen.workers),
        _parameter("config_dir", ConfigDir, DEFAULT_CONFIG),
        _parameter("plot", Plot, None),
        _parameter("json_file", JsonFile, None),
    ]


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
