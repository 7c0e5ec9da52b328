"""A layout for viewers of the Foxglove family: the scene in 3D, the picture with outlines, plots, the log."""

import json
from typing import Any

from controller.shell import scan_recorder as controller
from plant_emulator.shell import scene_messages
from plant_emulator.shell import truth_recorder as plant
from vision_pc.shell.recording import vision_recorder as vision

_SCENE, _PICTURE, _LOG = "3D!scene", "Image!left", "RosOut!log"
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_JOINTS = ("slew", "lift", "tilt", "wrist1", "wrist2", "wrist3")
PLOTS: dict[str, tuple[str, ...]] = {
    "Joint angles, rad": tuple(f"{controller.STATE}.q_meas_{joint}_rad" for joint in _JOINTS),
    "Valves": tuple(f"{controller.STATE}.valve_{joint}" for joint in _JOINTS),
    "Object as seen and as it is, m": (
        *(f"{vision.OBSERVATION}.p_CO_{axis}_m" for axis in "xyz"),
        *(f"{plant.TRUTH}.p_CO_{axis}_m" for axis in "xyz"),
    ),
}


def topics_shown() -> dict[str, set[str]]:
    """Every topic that the layout shows: the fields that it plots, none where it draws whole messages."""
    drawn = (plant.FRAMES, plant.SCENE, controller.FRAMES, vision.FRAMES, vision.PATH)
    pictured = (vision.IMAGES[0], vision.CALIBRATIONS[0], vision.ANNOTATIONS)
    shown: dict[str, set[str]] = {topic: set() for topic in (*drawn, *pictured, vision.LOG)}
    for path in (path for paths in PLOTS.values() for path in paths):
        topic, _, field = path.partition(".")
        shown.setdefault(topic, set()).add(field)
    return shown


def layout_text() -> str:
    """The layout file."""
    plots = {f"Plot!{number}": _plot(title, paths) for number, (title, paths) in enumerate(PLOTS.items())}
    right: Any = _SCENE
    left: Any = _PICTURE
    for panel in plots:
        left = {"first": left, "second": panel, "direction": "column", "splitPercentage": 45}
    panels = {_SCENE: _scene(), _PICTURE: _picture(), _LOG: {"topicToRender": vision.LOG}, **plots}
    below = {"first": right, "second": _LOG, "direction": "column", "splitPercentage": 75}
    tree = {"first": left, "second": below, "direction": "row", "splitPercentage": 45}
    document = {"configById": panels, "globalVariables": {}, "userNodes": {}, "layout": tree}
    return json.dumps(document, indent=2) + "\n"


def _scene() -> dict[str, Any]:
    topics = {topic: {"visible": True} for topic in (plant.SCENE, vision.PATH)}
    return {
        "followTf": scene_messages.WORLD,
        "followMode": "follow-none",
        "topics": topics,
        "scene": {"transforms": {"labelSize": 0.1, "axisScale": 0.3}},
    }


def _picture() -> dict[str, Any]:
    annotated = {vision.ANNOTATIONS: {"visible": True}}
    mode = {"imageTopic": vision.IMAGES[0], "calibrationTopic": vision.CALIBRATIONS[0]}
    return {"imageMode": {**mode, "annotations": annotated}}


def _plot(title: str, paths: tuple[str, ...]) -> dict[str, Any]:
    curves = [
        {"value": path, "enabled": True, "timestampMethod": "receiveTime", "color": _COLOURS[number % 6]}
        for number, path in enumerate(paths)
    ]
    return {"title": title, "paths": curves, "showLegend": True, "isSynced": True, "showXAxisLabels": True}
