"""One way for every service to start and end: command line, configuration, event log, loop, exit status."""

import argparse
import asyncio
import ctypes
import gc
import importlib.metadata
import json
import os
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import uvloop

from foundation import clock
from foundation.command_options import usual_configs
from foundation.configuration import merged, parse_overrides
from foundation.event_log import EventLog, process_log
from protocol.errors import LongreachError

RECORDS = "LONGREACH_RECORDS"
"""The environment's variable for a directory in which every service records, each in one of its own."""

_REFUSED, _INTERRUPTED = 2, 130  # exit statuses
_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8  # glibc's malloc.h
_LARGE_BLOCK, _HEAPS = 128 * 1024, 2


class ServiceOptions(NamedTuple):
    """What the command line gives to a service. ``overrides``: of configuration keys, by file stem."""

    config_dir: Path
    overrides: dict[str, dict[str, Any]]
    record_dir: Path | None


class RunnableService(Protocol):
    """A service that has been made: its ports are bound, nothing runs yet."""

    async def run(self) -> int:
        """Serve until asked to end; return the exit status."""
        ...


class Switch(NamedTuple):
    """An option of one service alone: ``--name`` lays ``overrides`` over the configuration."""

    name: str
    help: str
    overrides: Mapping[str, Any]


class ServiceProgram(NamedTuple):
    """What ``python -m name`` is. ``make`` raises LongreachError for what cannot be started.

    ``files``: the configuration files that it reads; ``records``: what it writes in ``--record-dir``;
    ``follows``: the part as which it follows the plant's clock, if the environment names one.
    """

    name: str
    description: str
    example: str
    files: str
    records: str
    make: Callable[[ServiceOptions, EventLog], RunnableService]
    switches: tuple[Switch, ...] = ()
    follows: str = ""


def service_main(program: ServiceProgram, argv: list[str] | None = None) -> int:
    """Run a service; return its exit status.

    0: ended when asked to; 1: a part of it or of the program failed, as its log says; 2: refused to start,
    with one line on stderr; 130: Ctrl-C before it served.
    """
    _return_large_blocks()
    try:
        options = _options(program, argv)
        made = clock.follow(program.follows) or uvloop.new_event_loop
        with process_log(program.name) as log, asyncio.Runner(loop_factory=made) as runner:
            return runner.run(program.make(options, log).run())
    except LongreachError as error:
        print(f"{program.name}: {error.cause}: {error}", file=sys.stderr)
        return _REFUSED
    except KeyboardInterrupt:
        return _INTERRUPTED


def _return_large_blocks() -> None:
    """Have glibc give every large block, such as a picture, back to the kernel when it is freed.

    By itself it learns from the first ones freed to keep them in its heaps, one a thread, where small blocks
    that live on hold them in place: the memory of a service then steps up for hours.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:  # other C libraries have none
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BLOCK)
        mallopt(_M_ARENA_MAX, _HEAPS)


def say_ready(service: str, **fields: Any) -> None:
    """Print the one line on stdout by which a service says that it serves, and where.

    What the service is made of by then lives as long as it does, so the garbage collector need not look at it
    again: its full passes are rare while it does, and each holds a loop up for tens of milliseconds.
    """
    gc.collect()
    gc.freeze()
    print(json.dumps({"event": "ready", "service": service, "pid": os.getpid(), **fields}), flush=True)


def on_termination(call: Callable[[], None]) -> None:
    """Have the running loop ``call`` on SIGTERM and SIGINT."""
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, call)


def _records(service: str) -> Path | None:
    named = os.environ.get(RECORDS)
    return Path(named) / service if named else None


def _parser(program: ServiceProgram) -> argparse.ArgumentParser:
    epilog = f"example: {program.example}"
    parser = argparse.ArgumentParser(f"python -m {program.name}", None, program.description, epilog)
    parser.add_argument("--version", action="store_true", help="print the version and end")
    parser.add_argument(
        "--config-dir", type=Path, default=usual_configs(), help=f"directory of {program.files}"
    )
    parser.add_argument(
        "--set",
        action="extend",
        nargs="+",
        default=[],
        metavar="FILE.KEY=VALUE",
        help="override a key; repeatable; keys of other services' files are left to them",
    )
    parser.add_argument(
        "--record-dir",
        type=Path,
        default=_records(program.name),
        help=f"write {program.records} in this directory; else in ${RECORDS}/{program.name}, if set",
    )
    for switch in program.switches:
        parser.add_argument(switch.name, action="store_true", help=switch.help)
    return parser


def _options(program: ServiceProgram, argv: list[str] | None) -> ServiceOptions:
    arguments = _parser(program).parse_args(argv)
    if arguments.version:
        print(f"{program.name} {importlib.metadata.version('longreach')}")
        raise SystemExit(0)
    overrides = parse_overrides(arguments.set)
    for switch in program.switches:
        if getattr(arguments, switch.name.lstrip("-").replace("-", "_")):
            overrides = merged(overrides, switch.overrides)
    return ServiceOptions(arguments.config_dir, overrides, arguments.record_dir)
