"""``python -m testbed.cli``: the `longreach` command, for where it is not on the path."""

from testbed.cli.main import main

main()
