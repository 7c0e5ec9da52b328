"""What Ctrl-C leaves of every long command: what is kept, and what the same command does when run again.

The command line ends with it, the table of docs/commands.md is it, and a long test interrupts each of them.
"""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from testbed.reporting.console import err

INTERRUPTED = 130  # as a shell has it for SIGINT


class Interrupted(NamedTuple):
    """One row: what is kept, what the same command does after it, and the exit status."""

    kept: str
    again: str = "begins anew"
    status: int = INTERRUPTED


_NOTHING = Interrupted("nothing")
_ROWS = Interrupted("every finished row, in `rows.csv`", "goes on from there")
_RUN = Interrupted("logs and recordings, in the run's directory", "begins anew, in another directory")
_SERVED = Interrupted("everything: Ctrl-C is how it is ended", status=0)
LONG: Mapping[str, Interrupted] = MappingProxyType(
    {
        "demo": _RUN,
        "up": _SERVED,
        "soak": _RUN,
        "experiment": _ROWS,
        "commission": Interrupted("every finished joint, in the session's directory", "goes on from there"),
        "identify": _NOTHING,
        "replay": _NOTHING,
        "camera calibrate": _NOTHING,
        "camera emulate": _NOTHING,
        "hand-eye session run": Interrupted("every sample taken, in the rig's session", "goes on from there"),
        "odometry": _NOTHING,
        "picture effects": Interrupted("the pictures drawn until then"),
        "picture run": _NOTHING,
        "conformance": _NOTHING,
        "recording": Interrupted("nothing half made"),
        "proxy": _SERVED,
        "sniff": _SERVED,
    }
)


def long_command(words: Sequence[str]) -> str | None:
    """The long command that ``words``, options among them, begin with; None: one too short to be told of."""
    found = [name for name in LONG if list(words[: name.count(" ") + 1]) == name.split()]
    return max(found, key=len, default=None)


def table_rows() -> list[str]:
    """The table of docs/commands.md, line by line: of the commands that keep something."""
    return [
        f"| `{name}` | {left.kept} | {left.again} | {left.status} |"
        for name, left in LONG.items()
        if not left.kept.startswith("nothing")
    ]


@contextmanager
def nothing_half_made(target: Path) -> Iterator[None]:
    """Where Ctrl-C ends the block, a file or directory that it began is removed: it would be in the way."""
    there = target.exists()
    try:
        yield
    except KeyboardInterrupt:
        if target.is_dir() and not there:
            shutil.rmtree(target, ignore_errors=True)
        elif not there:
            target.unlink(missing_ok=True)
        raise


@contextmanager
def kept_on_ctrl_c(told: Callable[[], str]) -> Iterator[None]:
    """Where Ctrl-C ends the block, ``told`` is asked what is kept, and it is said; empty: nothing is."""
    try:
        yield
    except KeyboardInterrupt:
        if kept := told():
            err.print(kept, markup=False, highlight=False, soft_wrap=True)
        raise
