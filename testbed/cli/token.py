"""`longreach token`: secrets in files, for REST APIs beyond loopback and for the reference link."""

from pathlib import Path
from typing import Annotated

import typer

from foundation.secret_source import write_new_secret
from testbed.cli.root import CommandApp
from testbed.reporting.console import promised

app = CommandApp(help="Tokens of the REST APIs, and keys of the link.", no_args_is_help=True)


@app.command(epilog="Example: longreach token new operate.token look.token")
def new(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Files to be made.")],
    keep: Annotated[bool, typer.Option("--keep", help="Leave files alone that are there.")] = False,
) -> None:
    """Make files of 32 random bytes each that only their owner may read; nothing is shown of them."""
    for path in files:
        if keep and path.exists():
            continue
        write_new_secret(promised(path))
        typer.echo(f"{path}: made")
