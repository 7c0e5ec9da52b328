"""`longreach experiment NAME`, one command for every experiment of the catalogue."""

import inspect
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from foundation.command_options import options_of, with_signature
from laboratory.experiments.catalogue import CATALOGUE, Entry
from testbed.cli.options import DEFAULT_CONFIG, ConfigDir, JsonFile
from testbed.cli.root import CommandApp, CommandGroup

Count = Annotated[int | None, typer.Option("--count", min=1, help="How many seeds, from --seed on.")]
Seed = Annotated[
    int | None, typer.Option(min=0, help="The same seed is the same world; the first of several.")
]
Out = Annotated[
    Path | None,
    typer.Option("--out", help="Rows and pictures; rows that are there are not measured again."),
]
Fresh = Annotated[bool, typer.Option("--fresh", help="Measure all rows anew, also those that are there.")]
Workers = Annotated[
    int | None, typer.Option(min=0, max=64, help="How many workers to start; 0: run in this process.")
]
Scheduler = Annotated[
    str | None,
    typer.Option(help="A Dask scheduler that is there, such as tcp://host:8786; else workers are started."),
]

_ALL_ARMS = "both"  # of an experiment that runs two


class ExperimentGroup(CommandGroup):
    """The catalogue's experiments as commands; one is loaded when it is asked for, most are heavy."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        for name, entry in CATALOGUE.items():
            self.add_command(TyperCommand(name, help=f"{entry.shows} ({entry.cost} a run)"))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that ``args`` begin with, loaded, and the other arguments."""
        if args[0] in CATALOGUE:
            self.add_command(_loaded(args[0]))
        return super().resolve_command(ctx, args)


def _loaded(name: str) -> Any:
    entry, made = CATALOGUE[name], CommandApp(add_completion=False)
    example = f"Example: longreach experiment {name} --json {name}.json"
    made.command(name, help=entry.shows, epilog=example)(command_of(entry))
    return typer.main.get_command(made)


app = CommandApp(cls=ExperimentGroup, help="Seeded experiments that write tables.", no_args_is_help=True)


@app.callback()
def experiment() -> None:
    """Seeded experiments that write tables."""


def command_of(entry: Entry) -> Callable[..., None]:
    """The function behind a command: its options are the request's and those of all the methods' settings."""
    methods = [entry.load(method) for method in entry.places]
    own: dict[str, inspect.Parameter] = {}
    for one in methods:
        for option in options_of(one.settings):
            own.setdefault(option.name, option)

    def command(**options: Any) -> None:
        from laboratory.campaigns.campaign import CampaignRequest
        from laboratory.campaigns.experiment import perform
        from testbed.scenarios.arms import arm_directory

        method = options.pop("method", None)
        chosen_experiment = entry.load(method)
        if options.get("arm") not in (None, _ALL_ARMS):
            arm_directory(options["config_dir"], options["arm"])  # refused now, not by every run
        seed, workers = options.pop("seed", None), options.pop("workers")
        request = CampaignRequest(
            config_dir=options.pop("config_dir"),
            runs=options.pop("count", None) or chosen_experiment.runs,
            seed=chosen_experiment.seed if seed is None else seed,
            out=options.pop("out") or chosen_experiment.directory,
            scheduler=options.pop("scheduler"),
            workers=chosen_experiment.workers if workers is None else workers,
            fresh=options.pop("fresh"),
            json=options.pop("json_file"),
        )
        settings = chosen_experiment.settings(
            **_own_options(options, own, chosen_experiment.settings._fields, method)
        )
        raise typer.Exit(0 if perform(chosen_experiment, request, settings) else 1)

    parameters = [*own.values(), *_method(entry), *_common(methods)]
    with_signature(command, parameters)
    return command


def _own_options(
    options: dict[str, Any], own: dict[str, inspect.Parameter], fields: tuple[str, ...], method: str | None
) -> dict[str, Any]:
    """The options of the method. Raises BadParameter where one that only another method has was given."""
    for name, option in own.items():
        if name not in fields and options[name] != option.default:
            raise typer.BadParameter(f"--{name.replace('_', '-')} is not an option of --method {method}")
    return {name: options[name] for name in fields}


def _method(entry: Entry) -> list[inspect.Parameter]:
    if len(entry.places) == 1:
        return []
    methods = StrEnum("Method", {name: name for name in entry.places})  # type: ignore[misc]
    kind = Annotated[methods, typer.Option(help="Which method.")]
    return [_parameter("method", kind, next(iter(methods)))]


def _common(methods: list[Any]) -> list[inspect.Parameter]:
    chosen, alone = methods[0], len(methods) == 1
    counted = [
        _parameter("count", Count, chosen.runs if alone else None),
        _parameter("seed", Seed, chosen.seed if alone else None),
    ]
    return [
        *(counted if any(one.runs for one in methods) else []),
        _parameter("out", Out, chosen.directory if alone else None),
        _parameter("fresh", Fresh, False),
        _parameter("scheduler", Scheduler, None),
        _parameter("workers", Workers, chosen.workers if alone else None),
        _parameter("config_dir", ConfigDir, DEFAULT_CONFIG),
        _parameter("json_file", JsonFile, None),
    ]


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
