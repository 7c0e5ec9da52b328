"""The suites as a command of their own, where nothing else of ours is installed."""

import sys

import typer

from conformance.command import coupler, reference
from protocol.errors import LongreachError

app = typer.Typer(help="Numbered questions to any controller or coupler.")
for command in (reference, coupler):
    app.command()(command)


def main() -> None:
    """Run the command line: expected trouble is one line and status 2."""
    try:
        app()
    except LongreachError as error:
        print(f"{error.cause}: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
