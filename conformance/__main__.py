"""The suites as a command of their own, where nothing else of ours is installed."""

import sys

from conformance.command import app
from protocol.errors import LongreachError


def main() -> None:
    """Run the command line: expected trouble is one line and status 2."""
    try:
        app()
    except LongreachError as error:
        print(f"{error.cause}: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
