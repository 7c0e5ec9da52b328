"""Strict loading of YAML files into pydantic models, with one-line errors that name key, value and limit."""

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    ValidationInfo,
)

from foundation.numbers_as_written import StrictLoader, with_strict_numbers
from protocol.errors import ConfigurationError

_CAUSES = {"extra_forbidden": "unknown_key", "enum": "literal_error"}
"""Pydantic's word for an error → ours; a word out of several is one error, written as an enum or not."""


BASE_FILE = "base.yaml"
_MOST_LAYERS = 8
_MOST_LEVELS = 64  # of YAML
_SHOWN = 80  # characters of a value that is refused
_WANTS_KEYS = "keys with values are wanted"
_PARSER_WORDS = {  # what libyaml says → what is wrong
    "cannot start any token": "nothing begins so: lines are set in by spaces, no tabs; such text is quoted",
    "mapping values": "a second colon in one line, or a line that is set in farther than the one above",
    "expected ':'": "a key without the colon and space behind it", "unexpected end": "a quote is not closed",
    "did not find expected": "a line is set in otherwise than its neighbours, or lacks a comma or bracket",
    "undefined alias": "no such anchor (&) above", "unhashable key": "a key is one text",
    "could not determine a constructor": "such a tag is not read here: leave it out",
    "another document": "one document is wanted, and here begins another",
}  # fmt: skip
_WORDS = {  # pydantic's word for an error → our sentence; its own, where it does, begins otherwise
    "missing": "a value is wanted, there is none", "extra_forbidden": "no such key",
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false is wanted"),
    **dict.fromkeys(("int_type", "float_type", "float_parsing"), "a number in decimal digits is wanted"),
    **dict.fromkeys(("int_parsing", "int_from_float"), "a whole number in decimal digits is wanted"),
    **dict.fromkeys(("model_type", "model_attributes_type", "dict_type"), _WANTS_KEYS),
    "json_invalid": "from this character on it is no JSON: {error}",
    "string_type": "text is wanted, in quotes where it looks like something else",
    "path_type": "a path is wanted", "tuple_type": "a list is wanted", "invalid_key": "a key is text",
    "union_tag_not_found": "the key {discriminator} is wanted",
    "union_tag_invalid": "{discriminator} = {tag!r} is none of {expected_tags}",
}  # fmt: skip
_NOT_OURS = r"^(Value error, |(Input|String|Tuple|List) (?=should))| after validation"
_OF_SCHEMA = r"\[key\]|[a-z]+(-[a-z]+)*\[.*\)?, .*\]|function-.*"  # parts of a place that no file has


class StrictModel(BaseModel):
    """Base of all configurations, bodies and orders: unknown keys, NaN, infinity and what is no number where
    one is wanted are refused, instances are frozen.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Pydantic's own, with numbers that are read as ``with_strict_numbers`` says."""
        return with_strict_numbers(handler(source))


HostName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_]([A-Za-z0-9._-]*[A-Za-z0-9_])?$", max_length=253)]
"""A DNS name or an IPv4 address, without scheme, port and wildcard."""


def _alone(host: str) -> str:
    if not host or set(host) & set(" \t/[]") or host.count(":") == 1:
        raise ValueError("a name or an address alone is wanted: no scheme, port or brackets")
    return host


Host = Annotated[str, AfterValidator(_alone)]
"""A name or an address to listen on or to connect to."""


ModelT = TypeVar("ModelT", bound=BaseModel)


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in one YAML file.

    Raises ConfigurationError when the file is missing, is not YAML, or is not a mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigurationError("configuration.unreadable", f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        why = f"{path}: not UTF-8 at byte {error.start}"
        raise ConfigurationError("configuration.not_yaml", why) from error
    return parse_mapping(text, str(path))


def parse_mapping(text: str, where: str) -> dict[str, Any]:
    """The mapping that YAML ``text`` is; ``where`` names its origin. Raises ConfigurationError as
    ``read_yaml``.
    """
    data = parse_yaml(text, where)
    if not isinstance(data, dict):
        found = "nothing is written" if data is None else f"not {_as_written(data)}"[:_SHOWN]
        raise ConfigurationError("configuration.not_a_mapping", f"{where}: {_WANTS_KEYS}, {found}")
    return data


def parse_yaml(text: str, where: str, loader: type[StrictLoader] = StrictLoader) -> Any:
    """What YAML ``text`` holds; ``where`` names its origin. Raises ConfigurationError, also for more than 64
    levels, which would break the parser itself.
    """
    try:
        depth = 0
        for event in yaml.parse(text, Loader=yaml.CSafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > _MOST_LEVELS:
                raise yaml.YAMLError(f"more than {_MOST_LEVELS} levels: {event.start_mark}")
        return yaml.load(text, Loader=loader)
    except (yaml.YAMLError, UnicodeEncodeError) as error:
        raise ConfigurationError("configuration.not_yaml", f"{where}: {_misspelt(error)}") from error
    except ConfigurationError as error:
        raise ConfigurationError(error.cause, f"{where}: {error}") from error


def _misspelt(error: yaml.YAMLError | UnicodeEncodeError) -> str:
    """Where and why a text is no YAML, in words of ours where the parser's say little."""
    if isinstance(error, UnicodeEncodeError):  # of a byte that is no UTF-8 on the command line
        return f"character {error.start + 1} is none of Unicode"
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem_mark is None:
        return " ".join(str(error).replace(' in "<unicode string>",', " at").split())
    at, begun, said = error.problem_mark, error.context_mark, error.problem or ""
    why = next((ours for its, ours in _PARSER_WORDS.items() if its in said), said)
    from_line = "" if begun is None or begun.line == at.line else f", in what begins in line {begun.line + 1}"
    return f"line {at.line + 1}, column {at.column + 1}{from_line}: {why}"


def merged(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with ``overrides`` laid over it, nested mappings merged key by key, anything else replaced."""
    result = dict(base)
    for key, value in overrides.items():
        below = result.get(key)
        result[key] = (
            merged(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
        )
    return result


class _Base(StrictModel):
    """``base.yaml``: the directory, counted from its own, over whose files its own are laid."""

    over: str


def layers(directory: Path) -> list[Path]:
    """The directories of which a configuration directory is made, the lowest first; most have one.

    A directory with a ``base.yaml`` lies over the one that it names. Raises ConfigurationError.
    """
    found = [directory]
    while (found[-1] / BASE_FILE).is_file():
        file = found[-1] / BASE_FILE
        below = validated(_Base, read_yaml(file), str(file)).over
        found.append(Path(os.path.normpath(found[-1] / below)))
        if not found[-1].is_dir():
            raise ConfigurationError("configuration.no_base", f"{file}: over: no directory {found[-1]}")
        if len(found) > _MOST_LAYERS:
            why = f"{file}: over = {below!r}: more than {_MOST_LAYERS} directories over each other"
            raise ConfigurationError("configuration.base_circle", why)
    return found[::-1]


def laid_over(directory: Path, name: str) -> tuple[dict[str, Any], str]:
    """The content of a file of a configuration directory, merged from its layers, and which files that were.

    Raises ConfigurationError as ``read_yaml`` and ``layers`` do.
    """
    files = [layer / name for layer in layers(directory)]
    there = [file for file in files if file.is_file()] or files[:1]
    content: dict[str, Any] = {}
    for file in there:
        content = merged(content, read_yaml(file))
    return content, " over ".join(map(str, reversed(there)))


def load(model: type[ModelT], path: Path, overrides: Mapping[str, Any] | None = None) -> ModelT:
    """The file at ``path``, laid over its base's, and ``overrides`` over it, as a validated ``model``.

    Raises ConfigurationError with one line that names file, key, value and limit of the first fault.
    """
    content, where = laid_over(path.parent, path.name)
    return validated(model, merged(content, overrides or {}), where, path.parent)


def validated(
    model: type[ModelT], data: Mapping[str, Any], where: str, directory: Path | None = None
) -> ModelT:
    """``data`` as a validated ``model``; ``where`` names its origin in the error.

    ``directory``: where the further files are that it names (``beside``), else in the working directory.
    """
    try:
        return model.model_validate(data, context={"directory": directory or Path()})
    except ValidationError as error:
        first = error.errors()[0]
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        cause = _CAUSES.get(first["type"], first["type"])
        why = _like(model, first["loc"]) if cause == "unknown_key" else None
        raise ConfigurationError(
            f"configuration.{cause}", f"{where}: {fault_words(first, why)}{more}"
        ) from error


def fault_words(fault: Mapping[str, Any], why: str | None = None) -> str:
    """``key = value: why`` of one of pydantic's errors; ``why``: where somebody knows it better.

    A value that is missing or has keys of its own is not shown.
    """
    key = ".".join(str(p) for p in fault["loc"] if not re.fullmatch(_OF_SCHEMA, str(p))) or "(whole file)"
    # A key written where only its place may be named must not reach a log on top of it.
    hidden = fault["type"] == "missing" or "link_key" in fault["loc"] or isinstance(fault["input"], Mapping)
    value = "" if hidden else f" = {_as_written(fault['input'])}"[:_SHOWN]
    header = ", with the header Content-Type: application/json" if isinstance(fault["input"], bytes) else ""
    return f"{key}{value}: {why or fault_reason(fault)}{header}"


def fault_reason(fault: Mapping[str, Any]) -> str:
    """Why, of one of pydantic's errors, without place and value."""
    words = _WORDS.get(fault["type"])
    return words.format(**fault.get("ctx", {})) if words else re.sub(_NOT_OURS, "", str(fault["msg"]))


def _as_written(value: Any) -> str:
    plain = repr(value).replace("True", "true").replace("False", "false").replace("None", "null")
    return repr(value) if isinstance(value, str) else plain


def _like(model: Any, loc: tuple[int | str, ...]) -> str:
    """What may have been meant by a key that ``model`` does not have at ``loc``."""
    for part in loc[:-1]:
        field = getattr(model, "model_fields", {}).get(part)
        model = None if field is None else field.annotation
    known = list(getattr(model, "model_fields", {}))
    close = get_close_matches(str(loc[-1]), known, 1)
    hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(known)}"
    return f"no such key; {hint}" if known else "no such key"


def beside(value: str | Path, info: ValidationInfo) -> Path:
    """Where the file is that a configuration names: in the configuration's directory, in one that this lies
    over, else from the working directory; where there is none, in the configuration's directory.
    """
    directory = (info.context or {}).get("directory", Path())
    places = [layer / value for layer in reversed(layers(directory))]
    return next((path for path in [*places, Path(value)] if path.exists()), places[0])


def or_its_file(model: type[BaseModel]) -> BeforeValidator:
    """For ``Annotated[M, or_its_file(M)]``: a mapping as it stands, or the path of a YAML file that holds it.

    A relative path is looked for as ``beside`` does.
    """

    def opened(value: Any, info: ValidationInfo) -> Any:
        return load(model, beside(value, info)) if isinstance(value, str) else value

    return BeforeValidator(opened)


def parse_overrides(assignments: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Overrides by file stem, from dotted assignments: ``plant.valves.deadband=0.03`` goes to ``plant``.

    The value is parsed as YAML. Raises ConfigurationError for an assignment without ``=`` or without a key
    below the file's name, for a value that is not YAML, and for two assignments that contradict each other.
    """
    overrides: dict[str, dict[str, Any]] = {}
    for assignment in assignments:
        dotted, equals, text = assignment.partition("=")
        path = [part.strip() for part in dotted.split(".")]
        if not equals or len(path) < 2 or not all(path):
            raise ConfigurationError("configuration.bad_override", f"'{assignment}': wanted FILE.KEY…=VALUE")
        value = parse_yaml(text, f"'{assignment}'")
        below: dict[str, Any] = overrides
        for part in path[:-1]:
            below = below.setdefault(part, {})
            if not isinstance(below, dict):
                raise ConfigurationError(
                    "configuration.contradiction", f"'{assignment}': {part} already has a value"
                )
        if path[-1] in below:
            raise ConfigurationError("configuration.contradiction", f"'{assignment}': set twice")
        below[path[-1]] = value
    return overrides


def configuration_hash(model: BaseModel) -> int:
    """A 64-bit number, never 0, that changes with every value in ``model`` and not with order or formatting.

    The reference link carries it as ``arm_hash``, so both sides know that they speak of the same arm.
    """
    text = json.dumps(model.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") or 1
