"""Options that several experiments share, worded once, and those of every experiment as JSON.

``option_shapes.json`` beside this lets help be shown without what an experiment runs with. It is written by
``python -m tests.laboratory.test_experiment_command``; a test compares the two.
"""

import inspect
import json
from collections.abc import Sequence
from enum import StrEnum
from functools import cache
from pathlib import Path
from types import GenericAlias, NoneType, UnionType
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

import typer
from typer import Option
from typer.models import ArgumentInfo

Assignments = Annotated[
    list[str] | None, Option("--set", help="Override one key, such as plant.payload.mass_kg=30; repeatable.")
]
Scenario = Annotated[str, Option(help="Which of CONFIG_DIR/scenarios to draw the world from.")]


class EyesKind(StrEnum):
    """What vision measures with."""

    PIXELS = "pixels"
    MODEL = "model"


ChosenEyes = Annotated[EyesKind, Option(help="Rendered pictures, or the model measured from them.")]
Adapting = Annotated[
    bool,
    Option("--adapting", help="Vision that learns, CONFIG_DIR/vision_adapting.yaml laid over its own."),
]
Commissioned = Annotated[
    bool,
    Option(
        "--commissioned", help="The controller has the valves' numbers, drawn around the truth with their σ."
    ),
]


PINNED = Path(__file__).with_name("option_shapes.json")
_TYPES: dict[str, Any] = {kind.__name__: kind for kind in (bool, int, float, str)} | {"Path": Path}
_INFO = ("help", "min", "max", "metavar")


class ShownExperiment(NamedTuple):
    """What the help of an experiment tells: its defaults, and the parameters of its own settings."""

    runs: int
    seed: int
    workers: int
    directory: Path
    parameters: Sequence[inspect.Parameter]


def pinned(name: str) -> ShownExperiment | None:
    """What is written down of the experiment called ``name``; None: nothing."""
    record = _table().get(name)
    if record is None:
        return None
    options = [_parameter(option) for option in record["options"]]
    return ShownExperiment(
        record["runs"], record["seed"], record["workers"], Path(record["directory"]), options
    )


def written_down(shown: ShownExperiment) -> dict[str, Any]:
    """``shown`` as JSON."""
    return {
        "runs": shown.runs,
        "seed": shown.seed,
        "workers": shown.workers,
        "directory": str(shown.directory),
        "options": [_option_record(parameter) for parameter in shown.parameters],
    }


@cache
def _table() -> dict[str, Any]:
    if not PINNED.is_file():
        return {}
    table: dict[str, Any] = json.loads(PINNED.read_text(encoding="utf-8"))
    return table


def _option_record(parameter: inspect.Parameter) -> dict[str, Any]:
    kind, info = get_args(parameter.annotation)
    optional = get_origin(kind) in (Union, UnionType)
    if optional:
        (kind,) = (one for one in get_args(kind) if one is not NoneType)
    several = get_origin(kind) is list
    if several:
        (kind,) = get_args(kind)
    chosen = issubclass(kind, StrEnum)
    return {
        "name": parameter.name,
        "argument": isinstance(info, ArgumentInfo),
        "kind": [str(one) for one in kind] if chosen else kind.__name__,
        "optional": optional,
        "several": several,
        "default": str(parameter.default) if (chosen or kind is Path) and not several else parameter.default,
        "flags": [flag for flag in (info.default, *(info.param_decls or ())) if isinstance(flag, str)],
        **{name: getattr(info, name) for name in _INFO if getattr(info, name) is not None},
    }


def _parameter(record: dict[str, Any]) -> inspect.Parameter:
    kind, default = record["kind"], record["default"]
    made: Any
    if isinstance(kind, list):
        chosen: Any = StrEnum("Chosen", {name: name for name in kind})  # type: ignore[misc]
        made, default = chosen, default if record["several"] else chosen(default)
    else:
        made = _TYPES[kind]
        default = Path(default) if made is Path else default
    if record["several"]:
        made = GenericAlias(list, made)
    if record["optional"]:
        made = made | None
    made_by = typer.Argument if record["argument"] else typer.Option
    info = made_by(*record["flags"], **{name: record[name] for name in _INFO if name in record})
    return inspect.Parameter(
        record["name"], inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[made, info]
    )
