"""`longreach experiment NAME`, one command for every experiment of the catalogue."""

import inspect
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from foundation.command_options import options_of, with_signature
from laboratory.experiments.catalogue import CATALOGUE, Entry
from testbed.cli.options import DEFAULT_CONFIG
from testbed.cli.root import CommandApp

_ALL_ARMS = "both"  # of an experiment that runs two


class ExperimentGroup(TyperGroup):
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
    from laboratory.campaigns.campaign import CampaignRequest
    from laboratory.campaigns.experiment import perform
    from testbed.scenarios.arms import arm_directory

    methods = {name: entry.load(name) for name in entry.places}
    usual = next(iter(methods))
    own = {option.name: option for one in [*methods.values()][::-1] for option in options_of(one.settings)}

    def command(**options: Any) -> None:
        method = options.pop("method", usual)
        chosen = methods[method]
        if options.get("arm") not in (None, _ALL_ARMS):
            arm_directory(options["config_dir"], options["arm"])  # refused now, not by every run
        for name, option in own.items():
            if name not in chosen.settings._fields and options[name] != option.default:
                raise typer.BadParameter(f"--{name.replace('_', '-')} is not an option of --method {method}")
        given = {name: options[name] for name in CampaignRequest._fields if options[name] is not None}
        settings = chosen.settings(**{name: options[name] for name in chosen.settings._fields})
        request = CampaignRequest(**(_defaults(chosen) | given))
        raise typer.Exit(0 if perform(chosen, request, settings) else 1)

    defaults = {"config_dir": DEFAULT_CONFIG} | {
        name: value if len(methods) == 1 else None for name, value in _defaults(methods[usual]).items()
    }
    shared = options_of(CampaignRequest)
    parameters = [
        *own.values(),
        *(one.replace(default=defaults.get(one.name, one.default)) for one in shared),
    ]
    if len(methods) > 1:
        names = StrEnum("Method", {name: name for name in methods})  # type: ignore[misc]
        kind = Annotated[names, typer.Option(help="Which method.")]
        parameters.append(
            inspect.Parameter("method", inspect.Parameter.KEYWORD_ONLY, default=names(usual), annotation=kind)
        )
    with_signature(command, parameters)
    return command


def _defaults(chosen: Any) -> dict[str, Any]:
    """What of a request each experiment has of its own."""
    return {
        "out": Path("runs") / chosen.name,
        "runs": chosen.runs,
        "seed": chosen.seed,
        "workers": chosen.workers,
    }
