"""Commands that are loaded when they are asked for, and what every command has: `--arm`, `-q` and `-v`."""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from testbed.reporting.console import Verbosity


class Later(NamedTuple):
    """A command or group, ``module`` or ``module:function``, and what the list of commands says of it."""

    place: str
    told: str
    example: str | None = None

    @property
    def package(self) -> str:
        """The top-level package that it comes from."""
        return self.place.partition(".")[0]

    @property
    def is_installed(self) -> bool:
        """Whether that package is there: the suites and the laboratory are distributions of their own."""
        return find_spec(self.package) is not None

    def load(self) -> Any:
        """The command itself."""
        module, _, function = self.place.partition(":")
        loaded = importlib.import_module(module)
        if not function:
            return typer.main.get_group(loaded.app)
        app = typer.Typer(add_completion=False)
        app.command(epilog=self.example)(getattr(loaded, function))
        return typer.main.get_command(app)


class LaterGroup(TyperGroup, ABC):
    """A group of which some commands are loaded later: ``later`` has what is told of each before that."""

    later: Mapping[str, str]

    @abstractmethod
    def load(self, name: str) -> Any:
        """The command called ``name``, one of ``later``."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names: those that are here, then the others."""
        return [*dict.fromkeys([*super().list_commands(ctx), *self.later])]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command called ``cmd_name``, or for the list of commands what is told of it; None: no such."""
        if cmd_name in self.commands:
            return dressed(self.commands[cmd_name])
        return TyperCommand(cmd_name, help=self.later[cmd_name]) if cmd_name in self.later else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that ``args`` begin with, loaded, and the other arguments."""
        if args[0] in self.later and args[0] not in self.commands:
            self.commands[args[0]] = self.load(args[0])
            self.commands[args[0]].name = args[0]
        elif self.get_command(ctx, args[0]) is None:  # what is like it may be among those
            self.commands = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        return super().resolve_command(ctx, args)


_DIRECTORY = "config_dir"


def dressed(command: Any) -> Any:
    """``command``, and all commands of a group, with what every command has.

    An experiment that has an `--arm` of its own, such as one that runs several, keeps that.
    """
    for inner in getattr(command, "commands", {}).values():
        dressed(inner)
    own = {parameter.name: parameter for parameter in command.params}
    if _DIRECTORY in own and "arm" not in own:
        own[_DIRECTORY].is_eager = True  # read first, so that the arm's takes its place
        command.params.insert(command.params.index(own[_DIRECTORY]) + 1, _arm_option())
    if not hasattr(command, "commands"):
        command.params += [option for option in _told_options() if option.name not in own]
    if not isinstance(command.parse_args, partial):
        command.parse_args = partial(_parsed, command.parse_args)
    return command


def _parsed(parse: Any, ctx: Any, arguments: list[str]) -> Any:
    try:
        return parse(ctx, arguments)
    except TyperException as refused:
        error: Any = refused
        error.ctx = getattr(error, "ctx", None) or ctx  # so that the line tells which help to read
        raise


def _chosen(ctx: typer.Context, arm: str | None) -> None:
    if arm is not None:
        from testbed.scenarios.arms import arm_directory

        ctx.params[_DIRECTORY] = arm_directory(Path(ctx.params[_DIRECTORY]), arm)


def _quiet(asked: bool) -> None:
    Verbosity.quiet = asked


def _verbose(asked: bool) -> None:
    Verbosity.verbose = asked


@cache
def _told_options() -> list[Any]:
    app = typer.Typer(add_completion=False)

    @app.command()
    def template(
        _quiet: Annotated[
            bool,
            typer.Option(
                "--quiet", "-q", help="Results alone, no progress.", callback=_quiet, expose_value=False
            ),
        ] = False,
        _verbose: Annotated[
            bool,
            typer.Option(
                "--verbose", "-v", help="Of a refusal also where.", callback=_verbose, expose_value=False
            ),
        ] = False,
    ) -> None: ...

    return list(typer.main.get_command(app).params)


@cache
def _arm_option() -> Any:
    app = typer.Typer(add_completion=False)

    @app.command()
    def template(
        _arm: Annotated[
            str | None,
            typer.Option(
                "--arm",
                metavar="NAME|DIR",
                help="Of CONFIG_DIR/arms, see `longreach arm list`, or a directory with base.yaml.",
                callback=_chosen,
                expose_value=False,
            ),
        ] = None,
    ) -> None: ...

    (option,) = typer.main.get_command(app).params
    option.name = "arm"
    return option
