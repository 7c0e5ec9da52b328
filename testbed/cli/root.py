"""Every command of ``longreach``: loaded when asked for; trouble is one line and a status, no traceback."""

import errno
import importlib.metadata
import re
import shutil
import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from protocol.errors import ConfigurationError, LongreachError
from testbed.reporting.console import INTERRUPTED, LONG, Verbosity, err, long_command, nothing_half_made


class Later(NamedTuple):
    """A command or group, ``module`` or ``module:function``, and what the list of commands says of it."""

    place: str
    told: str
    example: str | None = None

    @property
    def missing_package(self) -> str | None:
        """Its top-level package where that is not installed: the suites are a distribution of their own."""
        package = self.place.partition(".")[0]
        return package if find_spec(package) is None else None

    def load(self) -> Any:
        """The command itself."""
        module, _, function = self.place.partition(":")
        loaded = importlib.import_module(module)
        if not function:
            return typer.main.get_group(loaded.app)
        app = typer.Typer(add_completion=False)
        app.command(epilog=self.example)(getattr(loaded, function))
        return typer.main.get_command(app)


class LaterGroup(TyperGroup, ABC):
    """A group of which some commands are loaded later: ``later`` has what is told of each before that."""

    later: Mapping[str, str]

    @abstractmethod
    def load(self, name: str) -> Any:
        """The command called ``name``, one of ``later``."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names: those that are here, then the others."""
        return [*dict.fromkeys([*super().list_commands(ctx), *self.later])]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command called ``cmd_name``, or for the list of commands what is told of it; None: no such."""
        if cmd_name in self.commands:
            return dressed(self.commands[cmd_name])
        return TyperCommand(cmd_name, help=self.later[cmd_name]) if cmd_name in self.later else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that ``args`` begin with, loaded, and the other arguments."""
        if args[0] in self.later and args[0] not in self.commands:
            self.commands[args[0]] = self.load(args[0])
            self.commands[args[0]].name = args[0]
        elif self.get_command(ctx, args[0]) is None:  # what is like it may be among those
            self.commands = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        return super().resolve_command(ctx, args)


_DIRECTORY = "config_dir"


def dressed(command: Any) -> Any:
    """``command``, and all commands of a group, with what every command has.

    An experiment that has an `--arm` of its own, such as one that runs several, keeps that.
    """
    for inner in getattr(command, "commands", {}).values():
        dressed(inner)
    own = {parameter.name: parameter for parameter in command.params}
    if _DIRECTORY in own and "arm" not in own:
        own[_DIRECTORY].is_eager = True  # read first, so that the arm's takes its place
        command.params.insert(command.params.index(own[_DIRECTORY]) + 1, _arm_option())
    if not hasattr(command, "commands"):
        command.params += [option for option in _told_options() if option.name not in own]
    if not isinstance(command.parse_args, partial):
        command.parse_args = partial(_parse, command.parse_args)
    return command


def _parse(parse: Any, ctx: Any, arguments: list[str]) -> Any:
    try:
        return parse(ctx, arguments)
    except TyperException as refused:
        error: Any = refused
        error.ctx = getattr(error, "ctx", None) or ctx  # so that the line tells which help to read
        raise


def _choose_arm(ctx: typer.Context, arm: str | None) -> None:
    if arm is not None:
        from testbed.scenarios.arms import arm_directory

        ctx.params[_DIRECTORY] = arm_directory(Path(ctx.params[_DIRECTORY]), arm)


def _quiet(asked: bool) -> None:
    Verbosity.quiet = asked


def _verbose(asked: bool) -> None:
    Verbosity.verbose = asked


@cache
def _told_options() -> list[Any]:
    app = typer.Typer(add_completion=False)

    @app.command()
    def template(
        _quiet: Annotated[
            bool,
            typer.Option(
                "--quiet", "-q", help="Results alone, no progress.", callback=_quiet, expose_value=False
            ),
        ] = False,
        _verbose: Annotated[
            bool,
            typer.Option(
                "--verbose", "-v", help="Of a refusal also where.", callback=_verbose, expose_value=False
            ),
        ] = False,
    ) -> None: ...

    return list(typer.main.get_command(app).params)


@cache
def _arm_option() -> Any:
    app = typer.Typer(add_completion=False)

    @app.command()
    def template(
        _arm: Annotated[
            str | None,
            typer.Option(
                "--arm",
                metavar="NAME|DIR",
                help="Of CONFIG_DIR/arms, see `longreach arm list`, or a directory with base.yaml.",
                callback=_choose_arm,
                expose_value=False,
            ),
        ] = None,
    ) -> None: ...

    (option,) = typer.main.get_command(app).params
    option.name = "arm"
    return option


FAILED = 2
_TYPED = "longreach.typed"  # the words after `longreach`, in the context's notes
_COMMANDS = "longreach.commands"  # entry points: name of a command = its module


def _commands_of_others() -> dict[str, Later]:
    """Commands of installed distributions, such as the laboratory's `experiment`, by name."""
    points = importlib.metadata.entry_points(group=_COMMANDS)
    return {one.name: Later(one.value, one.dist.metadata["Summary"] if one.dist else "") for one in points}


_ABSENT = {"experiment": "laboratory"}  # command → the distribution and folder that has it
LATER = {
    **_commands_of_others(),
    "runs": Later("testbed.cli.runs", "Runs that were kept."),
    "recording": Later(
        "testbed.cli.recording", "What is in a recording, whether it is whole, what can be made of it."
    ),
    "config": Later("testbed.cli.config", "Every key that can be set: value, unit, limits, who sets it."),
    "arm": Later("testbed.cli.arm", "Arms: which there are, whether one is right, one of your own."),
    "camera": Later("testbed.cli.camera", "A stereo camera: check, calibrate, convert."),
    "hand-eye": Later("testbed.cli.hand_eye", "Hand-eye calibration, guided on a rig or from files."),
    "conformance": Later(
        "conformance.command",
        "Numbered questions to any controller or coupler, each citing a written clause.",
    ),
    "plc": Later(
        "testbed.cli.plc", "A PLC's variables over ADS: our controller in structured text, TwinCAT."
    ),
    "export": Later("testbed.exports.command", "The arm as a file for other tools."),
    "picture": Later("testbed.pictures.command", "Pictures that explain."),
    "target": Later(
        "testbed.cli.target:target",
        "A marker or board as a PDF at true scale, with rulers that tell whether the printer kept it.",
        "Example: longreach target --marker 582 --size-mm 50 --out marker.pdf",
    ),
    "token": Later("testbed.cli.token", "Tokens of the REST APIs, and keys of the link."),
}
PANELS = {  # in the order of use
    "Run": ("demo", "up", "experiment", "programs", "doctor"),
    "See what came out": ("runs", "recording", "replay"),
    "Your arm, camera and machine": (
        "init", "config", "arm", "target", "camera", "hand-eye", "commission", "markers",
        "odometry",
    ),
    "Put to the test": ("conformance", "plc"),
    "For other tools": ("export", "picture", "token"),
}  # fmt: skip
_PANEL = {name: panel for panel, names in PANELS.items() for name in names}
_CAUSES = {  # of what the command line itself refuses
    "NoSuchOption": "unknown_option",
    "MissingParameter": "missing",
    "BadParameter": "bad_value",
    "BadOptionUsage": "malformed",
    "BadArgumentUsage": "malformed",
}


class RootGroup(LaterGroup):
    """The group of all commands."""

    later = MappingProxyType({name: one.told for name, one in LATER.items() if one.missing_package is None})

    def load(self, name: str) -> Any:
        """The command or group called ``name``."""
        return LATER[name].load()

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that ``args`` begin with, loaded, and the other arguments.

        Raises ConfigurationError (``extension.not_installed``) for one of a distribution that is absent.
        """
        ctx.meta[_TYPED] = list(args)
        package = _ABSENT.get(args[0]) if args[0] not in LATER else LATER[args[0]].missing_package
        if package is not None:
            why = f"longreach {args[0]} is of the package {package}, which is not installed; in a checkout: "
            raise ConfigurationError("extension.not_installed", f"{why}pip install ./{package}")
        return super().resolve_command(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:
        """The names in the order of use."""
        names = super().list_commands(ctx)
        return [*(name for name in _PANEL if name in names), *(name for name in names if name not in _PANEL)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command called ``cmd_name``, in its panel of the help."""
        found = super().get_command(ctx, cmd_name)
        if found is not None:
            found.rich_help_panel = _PANEL.get(cmd_name)
        return found

    def make_context(self, *args: Any, **extra: Any) -> Any:
        """What the words before the command mean."""
        with _one_line():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; refusals, an operating system that will not, and Ctrl-C end the process."""
        with _one_line(ctx), nothing_half_made(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy's: what they warn of is refused in our words
            return super().invoke(ctx)


@contextmanager
def _one_line(ctx: Any = None) -> Iterator[None]:
    """What is refused becomes one line, in place of usage, hint, a frame or a traceback; so does Ctrl-C."""
    try:
        yield
    except TyperException as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            raise  # is help
        other = "unknown_command" if "No such command" in error.message else "wrong"
        cause = _CAUSES.get(type(error).__name__, other)
        command = getattr(getattr(error, "ctx", None), "command_path", "longreach")
        _end(f"usage.{cause}: {_in_words(error)}; see `{command} --help`", FAILED)
    except LongreachError as error:
        _end(f"{error.cause}: {error}", FAILED)
    except KeyboardInterrupt:
        name = long_command([] if ctx is None else ctx.meta.get(_TYPED, []))
        again = f"; run again, it {LONG[name].again}" if name else ""
        _end(f"ended by Ctrl-C{again}", INTERRUPTED)
    except (MemoryError, ImportError) as error:
        if isinstance(error, ImportError) and "map" not in str(error):
            raise
        from testbed.realtime.limits import least_memory

        limit = least_memory()
        room = f"{limit.bytes // 2**20} MB available to {limit.whose}: {limit.advice}"
        _end(f"system.memory: not enough memory ({error or 'allocation failed'}); {room}", FAILED)
    except BrokenPipeError:
        raise  # the reader of our output has gone; typer ends quietly
    except shutil.Error as error:  # of a copied directory: one of each file
        _end(f"system.refused: {error.args[0][0][1]}: {error.args[0][0][2]}", FAILED)
    except OSError as error:
        where = error.filename or ("output" if error.errno == errno.ENOSPC else "")
        _end(f"system.refused: {f'{where}: {error.strerror}' if where else error}", FAILED)


def _in_words(error: TyperException) -> str:
    close = sorted(getattr(error, "possibilities", None) or [])
    told = error.message if close else " ".join(error.format_message().split()).rstrip(".")
    why: Any = error.__cause__
    if hasattr(why, "errors"):  # pydantic's, which has the value
        given = why.errors()[0]["input"]
        told = told.replace(": Value error, ", ": ").replace(": Input should", f" = {given}: should")
    told = re.sub(r"\. Did you mean (.*)\?$", r"; did you mean \1?", told)
    return f"{told}; did you mean {' or '.join(close)}?" if close else told


def _end(told: str, status: int) -> None:
    if Verbosity.verbose:
        err.print_exception()
    err.print(f"longreach: {told}", style="bold red", highlight=False, soft_wrap=True, markup=False)
    sys.exit(status)


def show_version(asked: bool) -> None:
    """Print the version and end, where it was asked for."""
    if asked:
        typer.echo(f"longreach {importlib.metadata.version('longreach')}")
        raise typer.Exit
