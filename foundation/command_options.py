"""What commands share: the usual configuration, and options that belong together as one parameter.

Imported by every `--help`: nothing heavy may be.
"""

import dataclasses
import inspect
import io
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_type_hints

from protocol.errors import ConfigurationError

_BESIDE = Path(__file__).parents[1]  # of a checkout, or of what a wheel installed


def shipped_configs() -> Path:
    """The directory of the shipped configuration. Raises ConfigurationError when it is not there."""
    for directory in (_BESIDE / "longreach" / "configs", _BESIDE / "configs"):
        if (directory / "arm.yaml").is_file():
            return directory
    raise ConfigurationError("configuration.not_shipped", f"no configuration beside {_BESIDE / 'longreach'}")


def usual_configs() -> Path:
    """``configs`` of the working directory where there is one, else the shipped configuration."""
    here = Path("configs")
    return here if here.is_dir() else shipped_configs()


def host_and_port(text: str, where: str) -> tuple[str, int]:
    """What HOST:PORT says; ``where`` it is written. Raises ConfigurationError."""
    host, _, port = text.rpartition(":")
    written = re.fullmatch(r"\[[^][]+\]|[^][:\s/]+", host) and re.fullmatch("[0-9]{1,9}", port)
    if not written or not 0 < int(port) < 1 << 16:
        why = f"{where} is not HOST:PORT, nor [IPV6]:PORT, with a port from 1 to 65535"
        raise ConfigurationError("configuration.bad_value", why)
    return host.strip("[]"), int(port)


def options_of(kind: type[Any]) -> list[inspect.Parameter]:
    """The fields of a NamedTuple or dataclass as parameters of a command."""
    hints = get_type_hints(kind, include_extras=True)
    return [_option(field, hints[name]) for name, field in inspect.signature(kind).parameters.items()]


def unfolded(function: Callable[..., None]) -> Callable[..., None]:
    """``function`` for the command line: each field of a parameter that is such a type is an option."""
    hints, parameters, groups = get_type_hints(function, include_extras=True), [], {}
    for name, given in inspect.signature(function).parameters.items():
        if hasattr(hints[name], "_fields") or dataclasses.is_dataclass(hints[name]):
            groups[name] = hints[name], options_of(hints[name])
            parameters += groups[name][1]
        else:
            parameters.append(_option(given, hints[name]))

    def command(**given: Any) -> None:
        for name, (kind, fields) in groups.items():
            given[name] = kind(**{field.name: given.pop(field.name) for field in fields})
        function(**given)

    command.__name__, command.__doc__ = function.__name__, function.__doc__
    with_signature(command, parameters)
    return command


def with_signature(command: Callable[..., None], parameters: list[inspect.Parameter]) -> None:
    """Show ``command`` to the command line with these parameters."""
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}


def _option(given: inspect.Parameter, annotation: Any) -> inspect.Parameter:
    return given.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=annotation)


def show_any_letter() -> None:
    """Have output show a sign in place of letters that a terminal or log cannot show."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
