"""``python -m longreach``: the `longreach` command."""

import sys


def main() -> None:
    """Run the command. Ends with one line on another operating system, where imports would fail."""
    if sys.platform != "linux":
        sys.exit(f"longreach runs on Linux, this is {sys.platform}: use the containers (docs/containers.md)")
    try:
        from testbed.cli.main import main as run

        run()
    except KeyboardInterrupt:  # while it still imports, for seconds
        print("longreach: ended by Ctrl-C", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
