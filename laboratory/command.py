"""`longreach experiment NAME`, one command for every experiment of the catalogue, and `longreach soak`."""

import inspect
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from foundation.command_options import options_of, unfolded, with_signature
from laboratory.campaigns.options import ShownExperiment, pinned
from laboratory.experiments.catalogue import OURS, Entry, catalogue
from testbed.cli.options import (
    DEFAULT_CONFIG,
    DEFAULT_RUNS,
    ConfigDir,
    FreePorts,
    JsonFile,
    RunsDir,
    Settings,
)
from testbed.cli.options import Seed as FirstSeed
from testbed.cli.root import LaterGroup, dressed
from testbed.reporting.console import out, words, writable, write_json

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
Plot = Annotated[
    Path | None, typer.Option("--plot", help="Write the picture to this file.", callback=writable)
]

_ALL_ARMS = "both"  # of an experiment that runs two


class ExperimentGroup(LaterGroup):
    """The catalogue's experiments as commands; one is loaded when it is asked for."""

    @property
    def later(self) -> dict[str, str]:  # type: ignore[override]
        """What each experiment shows, with what a run of it costs."""
        return {name: f"{entry.shows} ({entry.cost} a run)" for name, entry in catalogue().items()}

    def load(self, name: str) -> Any:
        """The command of the experiment called ``name``."""
        entry = catalogue()[name]
        return typer.main.get_command(_app_of(entry, name, shown_of(entry)))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that ``args`` begin with; for help alone what it runs with is not loaded."""
        name = args[0]
        written = pinned(name) if "--help" in args and name in OURS and name not in self.commands else None
        if written is None:
            return super().resolve_command(ctx, args)
        command = dressed(typer.main.get_command(_app_of(OURS[name], name, written)))
        command.name = name
        return name, command, args[1:]


app = typer.Typer(cls=ExperimentGroup, help="Seeded experiments that write tables.", no_args_is_help=True)


@app.callback()
def experiment() -> None:
    """Seeded experiments that write tables."""


@app.command("list", epilog="Example: longreach experiment list --json experiments.json")
def list_experiments(json_file: JsonFile = None) -> None:
    """All experiments: what each shows, and what a run costs."""
    entries = [(name, entry.shows, entry.cost) for name, entry in catalogue().items()]
    out.print(words("experiments", ("longreach experiment", "shows", "a run costs"), entries))
    keys = ("experiment", "shows", "run_costs")
    write_json(json_file, {"experiments": [dict(zip(keys, entry, strict=True)) for entry in entries]})


def _app_of(entry: Entry, name: str, shown: ShownExperiment) -> typer.Typer:
    made = typer.Typer(add_completion=False)
    example = f"Example: longreach experiment {name} --json {name}.json"
    made.command(name, help=entry.shows, epilog=example)(command_of(entry, shown))
    return made


def shown_of(entry: Entry) -> ShownExperiment:
    """What help tells of an experiment, which is loaded; its options are those of all its methods."""
    usual, *others = (entry.load(method) for method in entry.places)
    options: dict[str, inspect.Parameter] = {}
    for one in (usual, *others):
        for option in options_of(one.settings):
            options.setdefault(option.name, option)
    runs = max(one.runs for one in (usual, *others))
    return ShownExperiment(runs, usual.seed, usual.workers, usual.directory, list(options.values()))


def command_of(entry: Entry, shown: ShownExperiment) -> Callable[..., None]:
    """The function behind a command: its options are the request's and the experiment's own settings."""

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
            plot=options.pop("plot"),
        )
        settings = chosen_experiment.settings(
            **_own(options, shown, chosen_experiment.settings._fields, method)
        )
        raise typer.Exit(0 if perform(chosen_experiment, request, settings) else 1)

    parameters = [*shown.parameters, *_method(entry), *_common(shown, len(entry.places) == 1)]
    with_signature(command, parameters)
    return command


def _own(
    options: dict[str, Any], shown: ShownExperiment, fields: tuple[str, ...], method: str | None
) -> dict[str, Any]:
    """The options of the method. Raises BadParameter where one that only another method has was given."""
    for option in shown.parameters:
        if option.name not in fields and options[option.name] != option.default:
            words = option.name.replace("_", "-")
            raise typer.BadParameter(f"--{words} is not an option of --method {method}")
    return {name: options[name] for name in fields}


def _method(entry: Entry) -> list[inspect.Parameter]:
    if len(entry.places) == 1:
        return []
    methods = StrEnum("Method", {name: name for name in entry.places})  # type: ignore[misc]
    kind = Annotated[methods, typer.Option(help="Which method.")]
    return [_parameter("method", kind, next(iter(methods)))]


def _common(chosen: ShownExperiment, alone: bool) -> list[inspect.Parameter]:
    counted = [
        _parameter("count", Count, chosen.runs if alone else None),
        _parameter("seed", Seed, chosen.seed if alone else None),
    ]
    return [
        *(counted if chosen.runs else []),
        _parameter("out", Out, chosen.directory if alone else None),
        _parameter("fresh", Fresh, False),
        _parameter("scheduler", Scheduler, None),
        _parameter("workers", Workers, chosen.workers if alone else None),
        _parameter("config_dir", ConfigDir, DEFAULT_CONFIG),
        _parameter("plot", Plot, None),
        _parameter("json_file", JsonFile, None),
    ]


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


class SoakOptions(NamedTuple):
    """How long a soak lasts, and how hard it is."""

    minutes: Annotated[float, typer.Option(min=0.1, max=1440.0, help="How long.")] = 10.0
    cycle_ms: Annotated[float, typer.Option(min=1.0, max=10.0, help="The controller's cycle.")] = 5.0
    faults: Annotated[bool, typer.Option("--faults", help="Break the plant at random times.")] = False


@unfolded
def soak(
    chosen: SoakOptions,
    seed: FirstSeed = 1,
    config_dir: ConfigDir = DEFAULT_CONFIG,
    settings: Settings = None,
    free_ports: FreePorts = False,
    runs: RunsDir = DEFAULT_RUNS,
    json_file: JsonFile = None,
) -> None:
    """Run all three services at rest and in motion, polled and followed; exit status 0 within all limits."""
    from foundation.configuration import merged, parse_overrides
    from laboratory.soak.command import SoakRequest, run_soak

    cycle = {"controller": {"cycle_ms": chosen.cycle_ms}}
    overrides = merged(parse_overrides(settings or []), cycle)
    request = SoakRequest(chosen.minutes, chosen.faults, seed, config_dir, overrides, free_ports, runs)
    raise typer.Exit(0 if run_soak(request, json_file) else 1)
