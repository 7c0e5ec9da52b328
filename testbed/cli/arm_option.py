"""`--arm` for every command that takes `--config-dir`: it chooses one of the arms in that directory."""

from functools import cache
from pathlib import Path
from typing import Annotated, Any

import typer

from testbed.scenarios.arms import arm_directory

_DIRECTORY = "config_dir"


def with_arm(command: Any) -> Any:
    """``command`` with the option, and all commands of a group with it, where they read a configuration.

    An experiment that has an `--arm` of its own, such as one that runs several, keeps that.
    """
    for inner in getattr(command, "commands", {}).values():
        with_arm(inner)
    own = {parameter.name: parameter for parameter in command.params}
    if _DIRECTORY in own and "arm" not in own:
        own[_DIRECTORY].is_eager = True  # read first, so that the arm's takes its place
        command.params.insert(command.params.index(own[_DIRECTORY]) + 1, _option())
    return command


def _chosen(ctx: typer.Context, arm: str | None) -> None:
    if arm is not None:
        ctx.params[_DIRECTORY] = arm_directory(Path(ctx.params[_DIRECTORY]), arm)


@cache
def _option() -> Any:
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
