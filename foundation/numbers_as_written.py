"""What counts as a number in files, on the command line and in requests: decimal digits and nothing else.

YAML 1.1 reads 010 as eight, 0x10 as sixteen, 1:30 as ninety and 1e3 as text; pydantic takes ``true`` as one
and ``"5"`` as five. Here each of them is the number that a person reads, or no number.
"""

import math
import re
from collections.abc import Hashable
from typing import Any

import yaml
from pydantic_core import PydanticCustomError, core_schema
from yaml.constructor import ConstructorError

from protocol.errors import ConfigurationError

_INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]{0,399})")  # of longer ones the interpreter has words of its own
_REAL = re.compile(
    r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
)
_WRITTEN = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_SHOWN = 60  # characters of what is no number
_YAML = "tag:yaml.org,2002:"
_TAGS = (f"{_YAML}int", f"{_YAML}float")
_KNOWN = (None, f"{_YAML}null", f"{_YAML}str", f"{_YAML}seq", f"{_YAML}map")  # None: refuses all others
_MOST_BITS = 64
_EXACT = 2**53  # [D] IEEE 754: from there on a real number of binary64 is not each integer
_NO_SCHEMAS = frozenset({"metadata", "default", "serialization", "expected"})  # of a core schema's keys


class StrictLoader(yaml.CSafeLoader):  # libyaml's: a third of the time
    """Safe YAML with numbers in decimal digits alone; other writings, and dates, are text. Of tags those of
    JSON's types are known. A key that is written twice is an error instead of a silent override.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for written, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if written.tag == f"{_YAML}merge":
                continue  # of keys that are merged in, the mapping's own take the place
            key = self.construct_object(written, deep=True)
            if not isinstance(key, Hashable):
                break  # the parser refuses it
            if key in seen:
                why = f"line {written.start_mark.line + 1}: key '{key}' is written twice"
                raise ConfigurationError("configuration.duplicate_key", why)
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_plain(self, node: yaml.ScalarNode) -> int | float | bool:
        """The number or truth value of a scalar, tagged as one or not. Raises ConstructorError for another
        writing.
        """
        text = str(self.construct_scalar(node))
        if _INTEGER.fullmatch(text):
            return int(text)
        if _REAL.fullmatch(text):
            return float(re.sub(r"\.(?=[in])", "", text.lower()))
        if text.lower() in self.bool_values:
            return self.bool_values[text.lower()]
        raise ConstructorError(None, None, f"{text!r} is no number in decimal digits", node.start_mark)


StrictLoader.yaml_implicit_resolvers = {
    first: [one for one in known if one[0] not in (*_TAGS, f"{_YAML}timestamp", f"{_YAML}value")]
    for first, known in yaml.CSafeLoader.yaml_implicit_resolvers.items()
}
StrictLoader.yaml_constructors = {tag: yaml.CSafeLoader.yaml_constructors[tag] for tag in _KNOWN}
StrictLoader.add_constructor(f"{_YAML}bool", StrictLoader.construct_plain)
for _tag, _writing in zip(_TAGS, (_INTEGER, _REAL), strict=True):
    StrictLoader.add_implicit_resolver(_tag, re.compile(f"(?:{_writing.pattern})$"), list("-+.0123456789"))
    StrictLoader.add_constructor(_tag, StrictLoader.construct_plain)


def written_number(value: Any) -> float:
    """The finite number that ``value`` is, a number or the text of one: U+2212 is a minus, as typesetters
    write it; decimal commas, digits of other scripts, truth values and groups of thousands are none. Raises
    ValueError that shows ``value``.
    """
    text = str(value).strip().replace("\u2212", "-")
    if not isinstance(value, bool) and _WRITTEN.fullmatch(text) and math.isfinite(float(text)):
        return float(text)
    shown = repr(value) if len(repr(value)) <= _SHOWN else repr(value)[:_SHOWN] + "…"
    raise ValueError(f"{shown} is no finite number in decimal digits")


def with_strict_numbers(schema: Any) -> Any:
    """A core schema of pydantic whose numbers take numbers alone, and truth values true and false alone.

    A whole real number (5.0, 1e3) is an integer as in JSON Schema; keys may be text, as those of JSON are.
    """
    if isinstance(schema, list | tuple):
        return type(schema)(with_strict_numbers(part) for part in schema)
    if not isinstance(schema, dict):
        return schema
    kind = schema.get("type")
    if kind == "bool":
        return schema | {"strict": True}
    if kind in ("int", "float"):
        return core_schema.no_info_before_validator_function(_number if kind == "float" else _integer, schema)
    if kind == "function-before" and schema["function"]["function"] in (_number, _integer, _key):
        return schema
    within = {
        name: part if name in _NO_SCHEMAS and isinstance(kind, str) else with_strict_numbers(part)
        for name, part in schema.items()
    }
    if kind == "dict" and schema.get("keys_schema", {}).get("type") == "int":
        within["keys_schema"] = core_schema.no_info_before_validator_function(_key, within["keys_schema"])
    return within


def _number(value: Any) -> Any:
    if isinstance(value, bool | str | bytes):
        raise PydanticCustomError("number", "a number in decimal digits is wanted")
    if isinstance(value, int) and value.bit_length() > _MOST_BITS:
        raise PydanticCustomError(
            "number", "an integer of at most {bits} bits is wanted", {"bits": _MOST_BITS}
        )
    return value


def _integer(value: Any) -> Any:
    if isinstance(value, float) and value.is_integer() and abs(value) >= _EXACT:
        words = "from {limit} on an integer is written without point and exponent"
        raise PydanticCustomError("number", words, {"limit": _EXACT})
    return _number(value)


def _key(value: Any) -> Any:
    return int(value) if isinstance(value, str) and _INTEGER.fullmatch(value) else value
