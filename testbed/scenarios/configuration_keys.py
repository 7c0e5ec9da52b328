"""Every key of the configuration files: value, what is allowed, what the file says."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from foundation.configuration import read_yaml

_NONE = object()  # null is a value
_LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}

Schema = Mapping[str, Any]


class Key(NamedTuple):
    """One line of a configuration file."""

    path: str
    value: str
    comment: str


def keys(file: Path) -> Iterator[Key]:
    """The keys of a YAML file that hold a value or a list, with the comments above and beside them.

    Raises ConfigurationError as ``read_yaml``.
    """
    read_yaml(file)
    text = file.read_text(encoding="utf-8")
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(root, yaml.MappingNode)
    yield from _keys(root, "", text.splitlines())


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
    here: Schema = schema
    for name in path.split("."):
        here = _resolve(schema, here)
        branches = [
            here,
            *(_resolve(schema, one) for one in (*here.get("anyOf", ()), *here.get("oneOf", ()))),
        ]
        # A name is a property, or one of the user's own.
        below = [
            branch.get("properties", {}).get(name, branch.get("additionalProperties")) for branch in branches
        ]
        here = next((found for found in below if isinstance(found, dict)), {})
    return _in_words(schema, here) if here else ""


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
