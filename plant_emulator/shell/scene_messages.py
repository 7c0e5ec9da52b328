"""The true scene as viewers draw it: wall, markers, holes and the arm's links, each fixed in its own frame.

What moves is moved by the transforms alone, so that the drawing is recorded once.
"""

from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from numpy.typing import NDArray

from foundation.recording.messages import PosedFrame, put_pose, put_time
from plant_emulator.config.camera import CameraConfig
from plant_emulator.config.scene import MarkerConfig, SceneConfig
from plant_emulator.core.camera.scene import printed_side, wall_marker_pose
from plant_emulator.core.camera.wall.bores import hole_places
from plant_emulator.core.mechanics.geometry import Chain, transform
from plant_emulator.core.truth import PlantTruth

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

WORLD, BASE, TOOL, CAMERA, MARKER, OBJECT = (
    "world",
    "true/base",
    "true/tool",
    "true/camera_left_optical",
    "true/tool_marker",
    "true/object",
)
_WALL_M, _THIN_M, _LINK_M = 4.0, 0.002, 0.12  # [D] drawn: the wall is endless, a plate thin, a link plain
_SHORT_M = 0.02  # links shorter than this are not drawn
_GREY, _WHITE, _YELLOW, _DARK = (0.5, 0.48, 0.45), (0.95, 0.95, 0.95), (0.95, 0.75, 0.1), (0.1, 0.1, 0.1)


class SceneDrawing(NamedTuple):
    """What is drawn of a plant: ``links`` the frames of its bodies, and messages that are recorded once.

    ``holes_O`` (n, 3): middles of the wall's drill holes in O.
    """

    links: tuple[str, ...]
    scene: bytes
    camera: bytes
    holes_O: Array


def drawing(config: SceneConfig, chain: Chain, time_ns: int) -> SceneDrawing:
    """The drawing of an arm in its scene, as of ``time_ns``."""
    links = tuple(f"true/{name}" for name in chain.names)
    scene, camera = _scene(config, chain, links, time_ns), _camera(config.camera, time_ns)
    return SceneDrawing(links, scene, camera, hole_places(config.wall))


def frames(truth: PlantTruth, links: tuple[str, ...], X_WL: Array) -> list[PosedFrame]:
    """All frames at one instant; ``X_WL`` (n, 4, 4) are those of the ``links``."""
    fixed = {BASE: truth.X_WB, TOOL: truth.X_WT, CAMERA: truth.X_WC, MARKER: truth.X_WM, OBJECT: truth.X_WO}
    named = [*fixed.items(), *zip(links, X_WL, strict=True)]
    return [PosedFrame(WORLD, child, X) for child, X in named]


def _scene(config: SceneConfig, chain: Chain, links: tuple[str, ...], time_ns: int) -> bytes:
    message = SceneUpdate()
    wall = _entity(message, "wall", OBJECT, time_ns)
    _cube(wall, _at(0.0, 0.0, -0.5 * _THIN_M), (_WALL_M, _WALL_M, _THIN_M), _GREY)
    for hole in config.wall.drill_holes:
        made = wall.cylinders.add(bottom_scale=1.0, top_scale=1.0)
        put_pose(made.pose, _at(*hole.centre_m, 0.0))
        made.size.x = made.size.y = 1e-3 * hole.diameter_mm
        made.size.z = _THIN_M
        _colour(made, _DARK)
    for marker in config.object_of_interest.markers:
        _marker(
            _entity(message, f"marker {marker.marker_id}", OBJECT, time_ns), marker, wall_marker_pose(marker)
        )
    _marker(_entity(message, "tool marker", MARKER, time_ns), config.tool_marker, np.eye(4))
    tool = chain.X_BT_home[:3, 3]
    for name, begun, ended in zip(links, chain.point, [*chain.point[1:], tool], strict=True):
        if (length := float(np.linalg.norm(ended - begun))) > _SHORT_M:
            made = _entity(message, name, name, time_ns).cylinders.add(bottom_scale=1.0, top_scale=1.0)
            put_pose(made.pose, _along((ended - begun) / length, 0.5 * (ended - begun)))
            made.size.x = made.size.y = _LINK_M
            made.size.z = length
            _colour(made, _YELLOW)
    return bytes(message.SerializeToString())


def _camera(config: CameraConfig, time_ns: int) -> bytes:
    """foxglove.CameraCalibration of the true left eye."""
    lens = config.lens
    message = CameraCalibration(
        frame_id=CAMERA,
        width=config.width_px,
        height=config.height_px,
        distortion_model="plumb_bob",
        D=[lens.k1, lens.k2, lens.p1, lens.p2, lens.k3],
        K=[lens.fx_px, 0.0, lens.cx_px, 0.0, lens.fy_px, lens.cy_px, 0.0, 0.0, 1.0],
        R=np.eye(3).ravel().tolist(),
        P=[lens.fx_px, 0.0, lens.cx_px, 0.0, 0.0, lens.fy_px, lens.cy_px, 0.0, 0.0, 0.0, 1.0, 0.0],
    )
    put_time(message.timestamp, time_ns)
    return bytes(message.SerializeToString())


def _entity(message: Any, name: str, frame: str, time_ns: int) -> Any:
    made = message.entities.add(id=name, frame_id=frame, frame_locked=True)
    put_time(made.timestamp, time_ns)
    return made


def _marker(entity: Any, marker: MarkerConfig, X: Array) -> None:
    printed = printed_side(marker)
    side = printed + 2.0 * marker.quiet_zone_m
    _cube(entity, X, (side, side, _THIN_M), _WHITE)
    _cube(entity, X @ _at(0.0, 0.0, 0.5 * _THIN_M), (printed, printed, _THIN_M), _DARK)
    text = entity.texts.add(billboard=True, font_size=0.5 * side, text=str(marker.marker_id))
    put_pose(text.pose, X)
    _colour(text, _WHITE)


def _cube(entity: Any, X: Array, size: Triple, colour: Triple) -> None:
    made = entity.cubes.add()
    put_pose(made.pose, X)
    made.size.x, made.size.y, made.size.z = size
    _colour(made, colour)


def _colour(made: Any, colour: Triple) -> None:
    made.color.r, made.color.g, made.color.b = colour
    made.color.a = 1.0


def _at(x: float, y: float, z: float) -> Array:
    return transform(np.eye(3), np.array([x, y, z]))


def _along(direction: Array, middle: Array) -> Array:
    """A pose (4, 4) at ``middle`` whose z is ``direction``."""
    aside = np.eye(3)[int(np.argmin(np.abs(direction)))]
    x = np.cross(aside, direction)
    x /= np.linalg.norm(x)
    return transform(np.column_stack((x, np.cross(direction, x), direction)), middle)
