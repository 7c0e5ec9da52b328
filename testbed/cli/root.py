"""How every command of ``longreach`` ends: expected trouble is one line and a status, never a traceback."""

import importlib.metadata
import sys
from typing import Any

import typer
from typer.core import TyperGroup

from protocol.errors import LongreachError
from testbed.reporting.console import err

FAILED = 2
INTERRUPTED = 130  # as a shell has it for SIGINT


class RootGroup(TyperGroup):
    """The group of all commands."""

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
