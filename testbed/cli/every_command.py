"""What every command has that it need not say: `--arm` beside `--config-dir`, `-q` and `-v`."""

from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from testbed.reporting.console import Verbosity

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
