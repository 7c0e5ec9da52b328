"""Every key of the configuration files: value, unit, what is allowed, what the file says, who sets it."""

import json
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from foundation.configuration import layers, load, read_yaml
from testbed.scenarios.scenario import MODELS

_NONE = object()  # null is a value
_LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}

Schema = Mapping[str, Any]


class Key(NamedTuple):
    """One line of a configuration file."""

    path: str
    value: str
    comment: str


class DescribedKey(NamedTuple):
    """A key as ``--set`` takes it: shipped value, unit, what is allowed, what the file says, which overlays
    of the same directory (arms, scenarios) set or draw it.
    """

    key: str
    value: str
    unit: str
    allowed: str
    comment: str
    set_by: tuple[str, ...]


_UNITS = {
    "m": "m", "mm": "mm", "px": "px", "s": "s", "ms": "ms", "ns": "ns", "hz": "Hz", "rad": "rad",
    "mrad": "mrad", "deg": "°", "kg": "kg", "bar": "bar", "c": "°C", "k": "K", "bytes": "bytes", "n": "N",
}  # fmt: skip
_PER = {"s": "1/s", "m": "1/m", "k": "1/K", "bar": "1/bar"}


def described_keys(config_dir: Path, pattern: str = "") -> list[DescribedKey]:
    """The keys of ``config_dir`` whose name holds ``pattern``, or matches it where it has a ``*``.

    Those that a file leaves out come with their default. Raises ConfigurationError for a file that is absent
    or that no service would start with.
    """
    setters = _setters(config_dir)
    found = []
    for name, model in MODELS.items():
        schema = model.model_json_schema()
        load(model, config_dir / f"{name}.yaml")
        files = (layer / f"{name}.yaml" for layer in layers(config_dir))
        written = list({key.path: key for file in files if file.is_file() for key in keys(file)}.values())
        absent = [Key(*one, "") for one in left_out(schema, {key.path for key in written})]
        for key in (*written, *absent):
            path = f"{name}.{key.path}"
            if not (fnmatchcase(path, pattern) if "*" in pattern else pattern in path):
                continue
            limits = allowed(schema, key.path)
            found.append(
                DescribedKey(path, key.value, unit(path), limits, key.comment, setters.get(path, ()))
            )
    return found


def unit(path: str) -> str:
    """The unit that a key's name ends in; empty: none."""
    *before, last = path.rpartition(".")[2].split("_")
    if (before and before[-1] == "per") or last in ("2", "3"):
        return _PER.get(last, "")
    return _UNITS.get(last, "") if before else ""


def _setters(config_dir: Path) -> dict[str, tuple[str, ...]]:
    """Key → the files below ``config_dir`` that lay something over it."""
    setters: dict[str, list[str]] = {}
    for file in sorted(config_dir.rglob("*.yaml")):
        name = str(file.relative_to(config_dir))
        if name.removesuffix(".yaml") in MODELS:
            continue
        for key in keys(file):
            path = key.path.removeprefix("draws.").removeprefix("overrides.")
            top = path if file.parent.name == "scenarios" else f"{file.stem.partition('_')[0]}.{path}"
            setters.setdefault(top, []).append(name)
    return {path: tuple(names) for path, names in setters.items()}


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
