"""Every key of every configuration file: shipped value, what is allowed, what the file says of it."""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import typer
import yaml

from testbed.cli.main import app
from testbed.scenarios.scenario import MODELS
from tools.tables import table


def commands_page(root: typer.Typer = app) -> str:
    """The reference of every command that can be run, by its words, in the order of the help."""
    found = _below(typer.main.get_command(root), "longreach", None)
    return "\n\n".join(_command(path, command) for path, command in found)


def _below(command: Any, path: str, parent: Any) -> Iterator[tuple[str, Any]]:
    context = command.context_class(command, info_name=path, parent=parent)
    if not hasattr(command, "list_commands"):
        yield path, command
        return
    for name in command.list_commands(context):
        _, found, _ = command.resolve_command(context, [name])  # loads what is loaded when it is asked for
        if not found.hidden:
            yield from _below(found, f"{path} {name}", context)


def _command(path: str, command: Any) -> str:
    context = command.context_class(command, info_name=path)
    usage = " ".join([path, *command.collect_usage_pieces(context)])
    rows = [_row(parameter, context) for parameter in command.get_params(context)]
    parts = [f"## {path}", _text(command.help or ""), f"```\n{usage}\n```"]
    if shown := [row for row in rows if row]:
        parts.append(table("option | what", shown))
    if command.epilog:
        parts.append(
            f"{_text(command.epilog.partition('Example: ')[0])}\n```\n{_example(command.epilog)}\n```"
        )
    return "\n\n".join(part for part in parts if part.strip())


def _example(epilog: str) -> str:
    return epilog.partition("Example: ")[2] or epilog


def _row(parameter: Any, context: Any) -> tuple[str, str] | None:
    record = parameter.get_help_record(context)
    if record is None or parameter.name == "help":
        return None
    names, told = record
    return f"`{names}`".replace("|", "\\|"), _text(told)


def _text(text: str) -> str:
    joined = re.sub(r"(?<!\n)\n(?!\n)", " ", text.strip()).replace("\b", "")
    return re.sub(r"([*<|\[_])", r"\\\1", joined) if "`" not in joined else joined.replace("|", "\\|")


CONFIGS = Path(__file__).parents[2] / "configs"
_LONGEST = 60  # characters of a value that is shown
_NONE = object()  # null is a value
_LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}

Schema = Mapping[str, Any]


class Key(NamedTuple):
    """One line of a configuration file."""

    path: str
    value: str
    told: str


def page() -> str:
    """The reference of all configuration files, in Markdown."""
    return "\n\n".join(_file(name) for name in MODELS)


def _file(name: str) -> str:
    schema = MODELS[name].model_json_schema()
    text = (CONFIGS / f"{name}.yaml").read_text(encoding="utf-8")
    written = list(keys(text))
    rows = [
        (f"`{key.path}`", _code(key.value), allowed(schema, key.path), _cell(key.told)) for key in written
    ]
    rows += [
        (f"`{path}`", _code(f"not written: {value}"), allowed(schema, path), "")
        for path, value in left_out(schema, {key.path for key in written})
    ]
    return f"## {name}.yaml\n\n" + table("key | shipped | allowed | what the file says", rows)


def keys(text: str) -> Iterator[Key]:
    """The keys of a YAML file that hold a value or a list, with the comments above and beside them."""
    lines = text.splitlines()
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(root, yaml.MappingNode)
    yield from _keys(root, "", lines)


def _keys(node: yaml.MappingNode, before: str, lines: list[str]) -> Iterator[Key]:
    for name, value in node.value:
        path = f"{before}{name.value}"
        if isinstance(value, yaml.MappingNode) and not value.flow_style:
            yield from _keys(value, f"{path}.", lines)
        else:
            start, end = value.start_mark, value.end_mark
            shown = " ".join(value.start_mark.buffer[start.index : end.index].split("#")[0].split())
            yield Key(path, shown.rstrip("\0 "), _comment(lines, name.start_mark.line))


def _comment(lines: list[str], line: int) -> str:
    above = line
    while above and lines[above - 1].lstrip().startswith("#"):
        above -= 1
    beside = lines[line].partition(" # ")[2]
    return " ".join([*(text.lstrip(" #") for text in lines[above:line]), beside]).strip()


def allowed(schema: Schema, path: str) -> str:
    """What the model takes at ``path``: kind and limits, as far as they stand in its schema."""
    found = _at(schema, path)
    return _in_words(schema, found) if found else ""


def _at(schema: Schema, path: str) -> Schema:
    here: Schema = schema
    for name in path.split("."):
        here = _branch(schema, here, name)
    return here


def _branch(root: Schema, here: Schema, name: str) -> Schema:
    here = _resolve(root, here)
    for branch in (here, *(_resolve(root, one) for one in (*here.get("anyOf", ()), *here.get("oneOf", ())))):
        if name in branch.get("properties", {}):
            found: Schema = branch["properties"][name]
            return found
        own = branch.get("additionalProperties")  # names of the user's own
        if isinstance(own, dict):
            return own
    return {}


def _resolve(root: Schema, here: Schema) -> Schema:
    if "$ref" not in here:
        return here
    found: Schema = root["$defs"][here["$ref"].rpartition("/")[2]]
    return found


def _in_words(root: Schema, found: Schema) -> str:
    found = _resolve(root, found)
    if kinds := [*found.get("anyOf", ()), *found.get("oneOf", ())]:
        return " or ".join(dict.fromkeys(filter(None, (_in_words(root, kind) for kind in kinds))))
    if "const" in found or "enum" in found:
        return ", ".join(f"`{word}`" for word in found.get("enum", [found.get("const")]))
    limits = [f"{sign} {found[word]:g}" for word, sign in _LIMITS.items() if word in found]
    return ", ".join([_kind(root, found), *limits])


def _kind(root: Schema, found: Schema) -> str:
    kind = str(found.get("type", "any"))
    if kind != "array":
        return {"object": "a mapping", "null": "null", "boolean": "true, false"}.get(kind, kind)
    parts = found.get("prefixItems") or [found.get("items", {})]
    inside = " or ".join(dict.fromkeys(_in_words(root, part) for part in parts))
    return f"{len(found['prefixItems'])} of: {inside}" if "prefixItems" in found else f"list of: {inside}"


def left_out(schema: Schema, written: set[str]) -> Iterator[tuple[str, Any]]:
    """Keys that are not in the file, and what they are then."""
    yield from _left_out(schema, schema, "", {}, written)


def _left_out(
    root: Schema, here: Schema, before: str, given: Mapping[str, Any], written: set[str]
) -> Iterator[tuple[str, Any]]:
    for name, found in here.get("properties", {}).items():
        path = f"{before}{name}"
        default = given.get(name, found.get("default", _NONE))
        below = _resolve(root, found)
        if path in written:
            continue
        if "properties" in below:
            yield from _left_out(
                root, below, f"{path}.", default if isinstance(default, dict) else {}, written
            )
        elif default is not _NONE and not any(other.startswith(f"{path}.") for other in written):
            yield path, json.dumps(default)


def _code(value: str) -> str:
    shown = value if len(value) <= _LONGEST else value[:_LONGEST] + " …"
    return f"`{_cell(shown)}`" if shown else ""


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;") if text else text
