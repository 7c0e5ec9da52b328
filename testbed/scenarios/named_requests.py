"""Words of the command line that name something and give it values: `KIND,joint=lift,angle_mrad=2`."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import yaml

from foundation.configuration import validated
from plant_emulator.core.faults.schedule import FaultOrder, order_with
from plant_emulator.shell.fault_desk import every_kind, installed_faults, own_kinds
from protocol.errors import ConfigurationError


class NamedRequest(NamedTuple):
    """A program, and what its request says."""

    name: str
    body: Mapping[str, Any]


def named_request(word: str) -> NamedRequest:
    """``NAME[,KEY=VALUE…]``, values as in YAML. Raises ConfigurationError (``configuration.bad_word``)."""
    name, *pairs = _parts(word)
    body = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not key or not equals:
            raise ConfigurationError("configuration.bad_word", f"{word}: {pair!r}: wanted KEY=VALUE")
        try:
            body[key.strip()] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise ConfigurationError("configuration.bad_word", f"{word}: {pair!r}: no value") from error
    return NamedRequest(name.strip(), body)


def fault_orders(words: Sequence[str]) -> tuple[FaultOrder, ...]:
    """What to break, of ours and of installed packages. ``start_after_s`` and ``duration_s`` say when.

    Raises ConfigurationError.
    """
    return tuple(_order(word) for word in words)


def _order(word: str) -> FaultOrder:
    kind, body = named_request(word)
    if kind not in every_kind():
        known = f"{', '.join(every_kind())}{installed_faults().why_not(kind)}"
        raise ConfigurationError(
            "configuration.unknown_fault", f"--fault {kind}: no such kind; known: {known}"
        )
    when = {key: body[key] for key in ("start_after_s", "duration_s") if key in body}
    fault = {"kind": kind} | {key: value for key, value in body.items() if key not in when}
    return validated(order_with(own_kinds()), {"fault": fault} | when, f"--fault {word}")


def _parts(word: str) -> list[str]:
    """``word`` cut at its commas, but for those inside brackets."""
    parts, depth = [""], 0
    for character in word:
        depth += (character in "[{") - (character in "]}")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return parts
