"""A service's own figures in Prometheus' text format, version 0.0.4 (prometheus.io, "Exposition formats")."""

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_NAME = re.compile(r"[a-z][a-z0-9_]*")


def exposition(service: str, figures: Mapping[str, Any]) -> str:
    """``figures`` as samples ``longreach_SERVICE_KEY``, nested keys joined by ``_``.

    Keys that are no names, such as causes, become the label ``cause``. Words, lists and what is absent have
    no sample. All are untyped: who counts and who measures is not told apart here.
    """
    told, lines = "", []
    for name, label, value in _samples(f"longreach_{service}", figures):
        if name != told:
            told = name
            lines.append(f"# TYPE {name} untyped")
        lines.append(f"{name}{label} {_number(value)}")
    return "".join(f"{line}\n" for line in lines)


def _samples(name: str, value: Any, label: str = "") -> Iterator[tuple[str, str, float]]:
    if isinstance(value, Mapping):
        named = all(_NAME.fullmatch(str(key)) for key in value)
        for key, item in value.items():
            if named:
                yield from _samples(f"{name}_{key}", item, label)
            else:
                yield from _samples(name, item, f'{{cause="{_escaped(str(key))}"}}')
    elif isinstance(value, int | float):
        yield name, label, value


def _number(value: float) -> str:
    if math.isfinite(value):
        return repr(int(value)) if isinstance(value, int) else repr(value)
    return "NaN" if math.isnan(value) else "+Inf" if value > 0 else "-Inf"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
