"""Disturbances of installed packages: entry points of ``longreach.disturbances``, KIND = ``module:CLASS``."""

import re
from functools import cache
from typing import Any

from foundation.extensions import Extensions, installed, of_type
from plant_emulator.core.faults.kinds import FAULTS, OwnFault
from protocol.errors import ConfigurationError

GROUP = "longreach.disturbances"
_KIND = re.compile(r"[a-z][a-z0-9_]*")


@cache
def installed_faults() -> Extensions[type[OwnFault]]:
    """The classes that can be injected beside ours, and those that were left out."""
    return installed(GROUP, FAULTS, _judged)


def own_kinds() -> tuple[type[OwnFault], ...]:
    """Those that can be injected."""
    return tuple(installed_faults().found.values())


def every_kind() -> dict[str, type[Any]]:
    """Kind to class, ours first."""
    return {**FAULTS, **installed_faults().found}


def _judged(name: str, value: Any) -> type[OwnFault]:
    kind: type[OwnFault] = of_type(type, "a class", value)
    if not issubclass(kind, OwnFault):
        why = f"{kind.__name__} is no plant_emulator.core.faults.kinds.OwnFault"
        raise ConfigurationError("extension.wrong_type", why)
    called = kind.model_fields["kind"].default
    if called != name or not _KIND.fullmatch(name):
        why = f"its kind is {called!r}: wanted the same word, such as encoder_wobble, as its default"
        raise ConfigurationError("extension.wrong_name", why)
    return kind
