"""What every command of ``longreach`` has; trouble is one line and a status, no traceback."""

import errno
import importlib.metadata
import re
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from protocol.errors import ConfigurationError, LongreachError
from testbed.reporting.console import INTERRUPTED, Verbosity, err, nothing_half_made

_DIRECTORY = "config_dir"


class SharedCommand(TyperCommand):
    """A command with ``--quiet``, ``--verbose`` and, where it has ``--config-dir``, ``--arm``.

    An experiment that has an ``--arm`` of its own, such as one that runs several, keeps that.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        own = {parameter.name: parameter for parameter in self.params}
        if _DIRECTORY in own and "arm" not in own:
            own[_DIRECTORY].is_eager = True  # read first, so that the arm's takes its place
            self.params.insert(self.params.index(own[_DIRECTORY]) + 1, _shared_options()[0])
        self.params += [option for option in _shared_options()[1:] if option.name not in own]


class CommandApp(typer.Typer):
    """A Typer whose commands are such, see ``SharedCommand``."""

    def command(  # type: ignore[override]
        self, name: str | None = None, *, cls: type[TyperCommand] = SharedCommand, **options: Any
    ) -> Callable[[Any], Any]:
        """As Typer's."""
        return super().command(name, cls=cls, **options)


def _choose_arm(ctx: typer.Context, arm: str | None) -> None:
    if arm is not None:
        from testbed.scenarios.arms import arm_directory

        ctx.params[_DIRECTORY] = arm_directory(Path(ctx.params[_DIRECTORY]), arm)


def _quiet(flag: bool) -> None:
    Verbosity.quiet = flag


def _verbose(flag: bool) -> None:
    Verbosity.verbose = flag


@cache
def _shared_options() -> tuple[Any, ...]:
    """``--arm``, ``--quiet`` and ``--verbose``."""
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

    arm, *others = typer.main.get_command(app).params
    arm.name = "arm"
    return arm, *others


FAILED = 2
PANELS = {  # in the order of use
    "Run": ("demo", "up", "experiment"),
    "See what came out": ("recording", "replay"),
    "Your arm, camera and machine": (
        "init", "arm", "target", "camera", "hand-eye", "commission", "markers",
        "odometry",
    ),
    "Put to the test": ("conformance",),
    "For other tools": ("export", "token"),
}  # fmt: skip
PANEL = {name: panel for panel, names in PANELS.items() for name in names}
_CAUSES = {  # of what the command line itself refuses
    "NoSuchOption": "unknown_option",
    "MissingParameter": "missing",
    "BadParameter": "bad_value",
    "BadOptionUsage": "malformed",
    "BadArgumentUsage": "malformed",
}


_ABSENT = {"experiment": "laboratory"}  # command → the distribution and folder that has it


class RootGroup(TyperGroup):
    """The group of all commands."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that ``args`` begin with, and the other arguments.

        Raises ConfigurationError (``extension.not_installed``) for one of a distribution that is absent.
        """
        if args[0] in _ABSENT and args[0] not in self.commands:
            package = _ABSENT[args[0]]
            why = f"longreach {args[0]} is of the package {package}, which is not installed; in a checkout: "
            raise ConfigurationError("extension.not_installed", f"{why}pip install ./{package}")
        return super().resolve_command(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:
        """The names in the order of use."""
        return sorted(super().list_commands(ctx), key=list(PANEL).index)

    def make_context(self, *args: Any, **extra: Any) -> Any:
        """What the words before the command mean."""
        with _one_line():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; refusals, an operating system that will not, and Ctrl-C end the process."""
        with _one_line(), nothing_half_made(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy's: what they warn of is refused in our words
            return super().invoke(ctx)


@contextmanager
def _one_line() -> Iterator[None]:
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
        _end("ended by Ctrl-C", INTERRUPTED)
    except (MemoryError, ImportError) as error:
        if isinstance(error, ImportError) and "map" not in str(error):
            raise
        more = "close something, or raise the limit of container (memory.max) or process (ulimit -v)"
        _end(f"system.memory: not enough memory ({error or 'allocation failed'}): {more}", FAILED)
    except BrokenPipeError:
        raise  # the reader of our output has gone; typer ends quietly
    except shutil.Error as error:  # of a copied directory: one of each file
        _end(f"system.refused: {error.args[0][0][1]}: {error.args[0][0][2]}", FAILED)
    except OSError as error:
        where = error.filename or ("output" if error.errno == errno.ENOSPC else "")
        _end(f"system.refused: {f'{where}: {error.strerror}' if where else error}", FAILED)


def _in_words(error: TyperException) -> str:
    close = sorted(getattr(error, "possibilities", None) or [])
    message = error.message if close else " ".join(error.format_message().split()).rstrip(".")
    why: Any = error.__cause__
    if hasattr(why, "errors"):  # pydantic's, which has the value
        from foundation.configuration import fault_reason

        fault = why.errors()[0]
        given = "" if fault["type"] == "value_error" else f" = {fault['input']}"
        message = f"{message.partition(': ')[0]}{given}: {fault_reason(fault)}".rstrip(".")
    message = re.sub(r"\. Did you mean (.*)\?$", r"; did you mean \1?", message)
    return f"{message}; did you mean {' or '.join(close)}?" if close else message


def _end(message: str, status: int) -> None:
    if Verbosity.verbose:
        err.print_exception()
    err.print(f"longreach: {message}", style="bold red", highlight=False, soft_wrap=True, markup=False)
    sys.exit(status)


def show_version(flag: bool) -> None:
    """Print the version and end, where it was asked for."""
    if flag:
        typer.echo(f"longreach {importlib.metadata.version('longreach')}")
        raise typer.Exit
