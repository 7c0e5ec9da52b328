"""Options of a command that belong together, as one parameter of the function behind it."""

import dataclasses
import inspect
from collections.abc import Callable
from typing import Any, get_type_hints


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
