"""Options that several experiments share, worded once."""

from enum import StrEnum
from typing import Annotated

from typer import Option

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
