"""The visible world as rigid poses and flat plates: where wall, object, tool marker and camera truly are."""

import math
from functools import cached_property
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.scene import (
    MarkerConfig,
    ObjectConfig,
    PoseConfig,
    SceneConfig,
    ToolMarkerConfig,
    WallMarkerConfig,
)
from plant_emulator.config.surroundings import PasserConfig
from plant_emulator.core.camera.boards import board_plates
from plant_emulator.core.camera.plates import Bend, plain_plate, printed_greys
from plant_emulator.core.camera.plates import Plate as Plate
from plant_emulator.core.camera.surroundings import (
    block_outline,
    block_plates,
    front_of,
    passer_plate,
)
from plant_emulator.core.faults.kinds import MarkerCovered
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform
from plant_emulator.core.truth import Mounts
from protocol.errors import RequestRefused

Matrix = NDArray[np.float64]

R_WO_FACING_ARM = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
R_TM_NOMINAL = np.diag([1.0, -1.0, -1.0])
_BRACKET_WIDTH_M = 0.05  # [D] the plain plate that carries the tool's marker, below it
_BRACKET_LENGTH_M = 0.35  # [D]
_BRACKET_GREY = 70.0  # [D]
_QUIET_CELLS = 1
_DICTIONARY = cv2.aruco.DICT_5X5_1000
_CELLS = 7  # five data cells and the black border on either side


def pose_matrix(pose: PoseConfig) -> Matrix:
    """4x4 homogeneous matrix of a configured pose."""
    return transform(rotation_matrix(pose.rotation_deg), np.array(pose.position_m))


def rotation_matrix(rotation_deg: tuple[float, float, float]) -> Matrix:
    """3x3 rotation matrix of a rotation vector given in degrees."""
    return rotation_from_vector(np.radians(np.array(rotation_deg, dtype=np.float64)))


def object_pose(config: ObjectConfig) -> Matrix:
    """X_WO (4x4): the nominal pose that faces the arm, tilted by ``tilt_deg`` in O's own axes."""
    return transform(R_WO_FACING_ARM @ rotation_matrix(config.tilt_deg), np.array(config.position_m))


def tool_marker_pose(config: ToolMarkerConfig) -> Matrix:
    """X_TM (4x4) as it truly is: nominal R = diag(1, -1, -1), then the misalignment in M's axes."""
    return transform(R_TM_NOMINAL @ rotation_matrix(config.misalignment_deg), np.array(config.offset_m))


def wall_marker_pose(config: WallMarkerConfig) -> Matrix:
    """Pose (4x4) in O of a marker's plate as it truly hangs."""
    R = rotation_matrix((0.0, 0.0, config.roll_deg)) @ rotation_matrix(config.misplaced_deg)
    return transform(R, np.array([*config.centre_m, 0.0]) + np.array(config.misplaced_m))


def printed_side(config: MarkerConfig) -> float:
    """Side length in metres as printed, the scale error included."""
    return config.side_m * (1.0 + config.print_scale_error)


def corners_in_plate(config: MarkerConfig) -> Matrix:
    """Four corners (4x3, metres) of the printed marker in its plate's axes, ArUco order: from top left,
    clockwise; off the plane z = 0 where the plate is bent.
    """
    half = printed_side(config) / 2.0
    corners = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]])
    corners[:, 2] = marker_bend(config).height(corners[:, 0], corners[:, 1])
    return corners


def marker_bend(config: MarkerConfig) -> Bend:
    """How a marker's plate is bent."""
    direction = math.radians(config.bend_direction_deg)
    curve = config.bend_m / (0.5 * config.side_m) ** 2
    return Bend(curve, math.cos(direction), math.sin(direction))


def marker_plate(config: MarkerConfig, X_parent_plate: Matrix, lit_by_wall: bool) -> Plate:
    """The plate of one marker: black and white cells as printed, surrounded by the quiet zone (if it has a
    width).
    """
    dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
    bits = cv2.aruco.generateImageMarker(dictionary, config.marker_id, _CELLS) > 127
    edges = np.linspace(-0.5, 0.5, _CELLS + 1) * printed_side(config)
    if config.quiet_zone_m > 0.0:
        bits = np.pad(bits, _QUIET_CELLS, constant_values=True)
        outer = printed_side(config) / 2.0 + config.quiet_zone_m
        edges = np.concatenate([[-outer], edges, [outer]])
    return Plate(X_parent_plate, edges, edges, printed_greys(bits), lit_by_wall, bend=marker_bend(config))


class Cover(NamedTuple):
    """A sheet over a marker, and the frame that it moves with: ``O`` on the wall, ``M`` on the tool."""

    parent: str
    plate: Plate


def cover_over(plate: Plate, fault: MarkerCovered) -> Plate:
    """The sheet that ``fault`` lays over a marker's ``plate``."""
    (left, right), (top, bottom) = ((edges[0], edges[-1]) for edges in (plate.edges_x, plate.edges_y))
    across, down = fault.share * (right - left), fault.share * (bottom - top)
    edges_x, edges_y = {
        "left": ((left, left + across), (top, bottom)),
        "right": ((right - across, right), (top, bottom)),
        "top": ((left, right), (top, top + down)),
        "bottom": ((left, right), (bottom - down, bottom)),
    }[fault.side]
    return plain_plate(plate.X_parent_plate, edges_x, edges_y, fault.grey)


class Passer(NamedTuple):
    """A plate that moves, and how."""

    plate: Plate
    config: PasserConfig

    def pose(self, time_s: float) -> Matrix:
        """X_OP (4x4)."""
        return transform(np.eye(3), np.array(self.config.place_m(time_s)))


class Scene:
    """Everything visible, as poses and plates. Stateless: what moves is passed in for each picture.

    ``mounts`` are the true poses (4x4) that the plant chains its own to: base and object in the world, camera
    and tool marker in the tool centre point. ``wall_plates`` have parent O, ``tool_plates`` parent M; both in
    painting order, and ``passers`` come between them. ``standing``: outlines, in O, of what hides the wall.
    """

    def __init__(self, config: SceneConfig) -> None:
        self.config = config
        self.mounts = Mounts(
            X_WB=pose_matrix(config.base),
            X_TC=pose_matrix(config.mount),
            X_TM=tool_marker_pose(config.tool_marker),
            X_WO=object_pose(config.object_of_interest),
        )
        self._wall_markers = tuple(
            marker_plate(marker, wall_marker_pose(marker), lit_by_wall=True)
            for marker in config.object_of_interest.markers
        )
        tool_marker = marker_plate(config.tool_marker, np.eye(4), lit_by_wall=False)
        self._marker_plates = {config.tool_marker.marker_id: ("M", tool_marker)} | {
            marker.marker_id: ("O", plate)
            for marker, plate in zip(config.object_of_interest.markers, self._wall_markers, strict=True)
        }
        self.standing = tuple(plate for block in config.wall.blocks for plate in block_outline(block))
        self.tool_plates = (self._bracket(), tool_marker)

    @property
    def shaded(self) -> bool:
        """Whether light depends on where in the scene a plate is."""
        return self.config.lighting.shadow.factor != 1.0

    @cached_property
    def wall_plates(self) -> tuple[Plate, ...]:
        """What is fixed to the wall or stands before it; some of it is painted only when first asked for."""
        config = self.config
        blocks = sorted(config.wall.blocks, key=lambda block: block.depth_m)
        return (
            *self._wall_markers,
            *(plate for block in blocks for plate in block_plates(block, config.wall)),
            *(plate for board in config.boards for plate in board_plates(board)),
        )

    @cached_property
    def passers(self) -> tuple[Passer, ...]:
        """What passes between wall and tool."""
        return tuple(Passer(passer_plate(config), config) for config in self.config.passers)

    def passing(self, time_s: float) -> tuple[Plate, ...]:
        """Outlines, in O, of what moves before the wall, at ``time_s``."""
        return tuple(front_of(passer.size_m, passer.place_m(time_s)) for passer in self.config.passers)

    def marker_corners(self) -> dict[int, tuple[Literal["O", "M"], Matrix]]:
        """Marker id → (parent frame "O" or "M", 4x3 corners in it in metres, ArUco order)."""
        tool = self.config.tool_marker
        corners: dict[int, tuple[Literal["O", "M"], Matrix]] = {tool.marker_id: ("M", corners_in_plate(tool))}
        for marker, plate in zip(self.config.object_of_interest.markers, self._wall_markers, strict=True):
            X_OP = plate.X_parent_plate
            corners[marker.marker_id] = ("O", corners_in_plate(marker) @ X_OP[:3, :3].T + X_OP[:3, 3])
        return corners

    def cover(self, fault: MarkerCovered) -> Cover:
        """What lies over a marker. Raises RequestRefused (``refused.unknown_marker``) when it is not here."""
        if fault.marker_id not in self._marker_plates:
            known = ", ".join(map(str, sorted(self._marker_plates)))
            raise RequestRefused("refused.unknown_marker", f"marker_id = {fault.marker_id}: here are {known}")
        parent, plate = self._marker_plates[fault.marker_id]
        return Cover(parent, cover_over(plate, fault))

    def _bracket(self) -> Plate:
        tool = self.config.tool_marker
        top = printed_side(tool) / 2.0 + tool.quiet_zone_m
        half = _BRACKET_WIDTH_M / 2.0
        reach = (top, top + _BRACKET_LENGTH_M)
        return plain_plate(np.eye(4), (-half, half), reach, _BRACKET_GREY)
