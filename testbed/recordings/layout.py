"""A layout for viewers of the Foxglove family: the scene in 3D, the picture with outlines, plots, the log."""

import json
from collections.abc import Sequence
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
    panels = {_SCENE: _scene(), _PICTURE: _picture(), _LOG: {"topicToRender": vision.LOG}, **plots}
    left = _beside("column", [_PICTURE, *plots], [34.0, *[66.0 / len(plots)] * len(plots)])
    tree = _beside("row", [left, _beside("column", [_SCENE, _LOG], [78.0, 22.0])], [40.0, 60.0])
    viewer = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1.0}}
    document = {"configById": panels, "layout": tree, **viewer}
    return json.dumps(document, indent=2) + "\n"


def _beside(direction: str, panels: Sequence[Any], shares: Sequence[float]) -> Any:
    """A tree of splits in which each panel has its share of the whole."""
    if len(panels) == 1:
        return panels[0]
    rest = _beside(direction, panels[1:], shares[1:])
    percent = round(100.0 * shares[0] / sum(shares), 1)
    return {"first": panels[0], "second": rest, "direction": direction, "splitPercentage": percent}


def _scene() -> dict[str, Any]:
    """Seen from beside the wall. Every frame's parent is the world: lines to it would hide the arm."""
    return {
        "followTf": scene_messages.WORLD,
        "followMode": "follow-none",
        "cameraState": {
            "perspective": True,
            "distance": 9.0,
            "phi": 68.0,
            "thetaOffset": 25.0,
            "target": [0.0, 0.0, 0.0],
            "targetOffset": [2.0, 0.0, 1.0],
            "targetOrientation": [0.0, 0.0, 0.0, 1.0],
            "fovy": 45.0,
            "near": 0.05,
            "far": 500.0,
        },
        "topics": {topic: {"visible": True} for topic in (plant.SCENE, vision.PATH)},
        "scene": {"transforms": {"labelSize": 0.06, "axisScale": 0.3, "lineWidth": 0.0}},
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
    legend = {"showLegend": True, "legendDisplay": "left", "sidebarDimension": 200}
    return {"title": title, "paths": curves, "isSynced": True, "showXAxisLabels": True, **legend}
