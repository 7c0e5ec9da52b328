"""The tool's marker where it is seen, else where the tool's outline says that it is."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vision_pc.config.vision import MarkerSettings
from vision_pc.core.perception import intrinsics, markers
from vision_pc.core.perception.markers import Sighting
from vision_pc.core.perception.stereo_pose import Priors
from vision_pc.core.perception.tool_outline import OutlineShift, remembered, shifts
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, FrameObservation, StereoPair, ToolMemory

_TAUGHT = 10  # frames that teach one by one
_EVERY = 10  # after them


class ToolSought(NamedTuple):
    """Sightings, the tool's among them if it is known, and why markers were refused, ``moved`` among them.

    ``std_px``: how far the outline leaves the tool's place in doubt, in all frames of a rest alike; None
    where its marker was seen, or neither.
    """

    sightings: list[Sighting]
    unfit: Mapping[int, str]
    std_px: float | None = None


def sought(
    pair: StereoPair,
    sightings: list[Sighting],
    unfit: Mapping[int, str],
    memory: ToolMemory | None,
    camera: CameraCalibration,
    settings: MarkerSettings,
    priors: Priors,
) -> ToolSought:
    """``sightings`` with the tool's marker by its outline, where a ``memory`` of it is all that there is."""
    number = settings.tool.id
    seen = number in unfit or any(each.observation.marker_id == number for each in sightings)
    found = None if seen or memory is None else shifts(memory, pair)
    if memory is None or found is None:
        return ToolSought(sightings, unfit)
    corners = [shift.moved(known) for shift, known in zip(found, (memory.left, memory.right), strict=True)]
    ways = [now - known for now, known in zip(corners, (memory.left, memory.right), strict=True)]
    if max(float(np.abs(way).max()) for way in ways) > settings.tool.outline_limit_px:
        return ToolSought(sightings, {**unfit, number: "moved"})
    left, right = (
        intrinsics.normalised(eye, pixels)
        for eye, pixels in zip((camera.left, camera.right), corners, strict=True)
    )
    start = markers.planar_start(number, left, settings)
    known = markers.from_rays(start, right, camera, settings, priors)
    if isinstance(known, str):
        return ToolSought(sightings, unfit)
    return ToolSought([*sightings, known], unfit, _std_px(found))


def _std_px(found: tuple[OutlineShift, OutlineShift]) -> float:
    return max(shift.std_px for shift in found)


def with_doubt(
    seen: FrameObservation, std_px: float, camera: CameraCalibration, settings: MarkerSettings
) -> FrameObservation:
    """A frame whose tool is known by its outline: its place is as uncertain as that, in every frame alike,
    and its marker is none that was seen.
    """
    read = tuple(marker for marker in seen.markers if marker.marker_id != settings.tool.id)
    if seen.X_CM is None or seen.cov_CM is None or seen.bias_CM is None:
        return seen._replace(markers=read)
    doubt = np.zeros((6, 6))
    doubt[0, 0] = doubt[1, 1] = (std_px * float(seen.X_CM[2, 3]) / float(camera.left.K[0, 0])) ** 2
    cov_CM, bias_CM = seen.cov_CM + doubt, seen.bias_CM + doubt
    return seen._replace(cov_CM=cov_CM, bias_CM=bias_CM, markers=read, by_outline=True)


def learnt(
    seen: FrameObservation,
    pair: StereoPair,
    memory: ToolMemory | None,
    camera: CameraCalibration,
    settings: MarkerSettings,
) -> ToolMemory | None:
    """The memory after a frame that shows the marker, unchanged after any other.

    The first frames and, as it costs 2 ms, every tenth after them teach.
    """
    corners = _corners(seen, settings)
    if corners is None or seen.X_CM is None or not settings.tool.outline_m:
        return memory
    if memory is not None and memory.frames >= _TAUGHT and seen.frame_id % _EVERY:
        return memory
    return remembered(memory, pair, corners, seen.X_CM, settings.tool, camera)


def _corners(seen: FrameObservation, settings: MarkerSettings) -> tuple[Array, Array] | None:
    for marker in seen.markers:
        if marker.marker_id == settings.tool.id and marker.corners_right is not None:
            return marker.corners_left, marker.corners_right
    return None
