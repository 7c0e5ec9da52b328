"""How every command of ``longreach`` ends: expected trouble is one line and a status, never a traceback."""

import importlib
import importlib.metadata
import sys
from typing import Any

import typer
from typer.core import TyperGroup

from protocol.errors import LongreachError
from testbed.cli.every_command import dressed
from testbed.reporting.console import err

FAILED = 2
INTERRUPTED = 130  # as a shell has it for SIGINT
LOADED_LATER = {  # what a group of commands needs, such as matplotlib and dask, no other command waits for
    "camera": "testbed.cli.camera",
    "experiment": "testbed.cli.experiment",
    "conformance": "conformance.command",
    "hand-eye": "testbed.cli.hand_eye",
    "export": "testbed.exports.command",
    "picture": "testbed.pictures.command",
    "recording": "testbed.cli.recording",
    "runs": "testbed.cli.runs",
    "arm": "testbed.cli.arm",
    "token": "testbed.cli.token",
}


class RootGroup(TyperGroup):
    """The group of all commands. A group among them is loaded when it is asked for, or help for all."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names in the order of the help."""
        own = [name for name in super().list_commands(ctx) if name not in LOADED_LATER]
        return [*own, *LOADED_LATER]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command called ``cmd_name``; None where there is none: then all are there for suggestions."""
        unknown = cmd_name not in self.commands and cmd_name not in LOADED_LATER
        for name in LOADED_LATER if unknown else {cmd_name} & set(LOADED_LATER):
            if name not in self.commands:
                group = typer.main.get_group(importlib.import_module(LOADED_LATER[name]).app)
                group.name = name
                self.commands[name] = group
        found = super().get_command(ctx, cmd_name)
        return None if found is None else dressed(found)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; refusals, an operating system that will not, and Ctrl-C end the process."""
        try:
            return super().invoke(ctx)
        except LongreachError as error:
            _end(f"{error.cause}: {error}", FAILED)
        except KeyboardInterrupt:
            _end("ended by Ctrl-C", INTERRUPTED)
        except BrokenPipeError:
            raise  # the reader of our output has gone; typer ends quietly
        except OSError as error:
            what = f"{error.filename}: {error.strerror}" if error.filename else str(error)
            _end(f"system.refused: {what}", FAILED)


def _end(told: str, status: int) -> None:
    err.print(f"longreach: {told}", style="bold red", highlight=False, soft_wrap=True, markup=False)
    sys.exit(status)


def show_version(asked: bool) -> None:
    """Print the version and end, where it was asked for."""
    if asked:
        typer.echo(f"longreach {importlib.metadata.version('longreach')}")
        raise typer.Exit
