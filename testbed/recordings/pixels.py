"""The pictures of a recording: those that it holds, or the same rendered again from the plant's recording."""

import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from foundation.recording.decoding import RecordingUnreadable
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.exposures import STILL, CameraView, Capture, Exposures, Shot
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.faults.kinds import FAULTS, Fault
from testbed.recordings.plant_truth import read_truth

Eyes = tuple[NDArray[np.uint8], NDArray[np.uint8]]


class RecordedStamp(NamedTuple):
    """What a recording says of a frame: its number and time, its size and its pixels' CRC-32."""

    frame_id: int
    capture_ns: int
    width: int
    height: int
    crc_left: int
    crc_right: int


class KeptPixels:
    """The pictures that the recording itself holds; each is given out once."""

    def __init__(self) -> None:
        self._kept: dict[int, dict[int, NDArray[np.uint8]]] = {}

    def add(self, eye: int, image: Any) -> None:
        """Keep a foxglove.RawImage of an eye until its frame is asked for."""
        capture_ns = image.timestamp.seconds * 1_000_000_000 + image.timestamp.nanos
        picture = np.frombuffer(image.data, dtype=np.uint8).reshape(image.height, image.width)
        self._kept.setdefault(capture_ns, {})[eye] = picture

    def of(self, stamp: RecordedStamp) -> Eyes | None:
        """The frame's pictures, if both are there; those of earlier frames are forgotten."""
        found = self._kept.pop(stamp.capture_ns, {})
        self._kept = {time_ns: eyes for time_ns, eyes in self._kept.items() if time_ns > stamp.capture_ns}
        return (found[0], found[1]) if len(found) == 2 else None


class RenderedPixels:
    """The pictures of an emulated camera once more, from where it was and what faults were in force."""

    def __init__(self, truth: Path) -> None:
        """Read the plant's recording at ``truth``.

        Raises OSError, RecordingUnreadable (also ``recording.motion_not_recorded``: a camera that shows
        motion, recorded before its motion was).
        """
        recording = read_truth(truth)
        config = SceneConfig.model_validate(recording.run.get("scene", {}))
        ours = (record for record in recording.faults if record.fault.get("kind") in FAULTS)
        read: TypeAdapter[Fault] = TypeAdapter(Fault)
        faults = [(record, read.validate_python(record.fault)) for record in ours]  # others act on no picture
        exposures = Exposures(config.camera, config.seed)
        self._shots: dict[int, Shot] = {}
        for record in recording.truths:
            if record.frame_id is not None:
                view = CameraView(record.truth.X_WC, record.truth.X_WM, record.truth.X_WO)
                now = [fault for recorded, fault in faults if recorded.in_force(record.truth.time_ns)]
                if config.camera.shows_motion and record.motion is None:
                    why = f"{truth.name}: its camera shows motion within an exposure, which is not recorded"
                    raise RecordingUnreadable("recording.motion_not_recorded", why)
                motion = STILL if record.motion is None else record.motion
                capture = Capture(record.frame_id, record.log_ns, view, motion)
                shot = exposures.shot(capture, now)
                self._shots[shot.frame_id] = shot
        self._config = config
        self._camera: StereoCamera | None = None

    def of(self, stamp: RecordedStamp) -> Eyes | None:
        """The frame rendered, if the plant recorded its capture."""
        shot = self._shots.get(stamp.frame_id)
        if shot is None:
            return None
        if self._camera is None:
            self._camera = StereoCamera(self._config.camera, Scene(self._config), self._config.seed)
        left, right = self._camera.take(shot)
        return left, right


Pixels = KeptPixels | RenderedPixels
"""Where a frame's pictures come from."""


def checked(stamp: RecordedStamp, eyes: Eyes) -> tuple[tuple[str, int, int], ...]:
    """Which eye's pixels are not those of the recording: its name, the CRC-32 as recorded and as it is."""
    stamped = (("left", stamp.crc_left, eyes[0]), ("right", stamp.crc_right, eyes[1]))
    found = ((name, crc, zlib.crc32(np.ascontiguousarray(picture).data)) for name, crc, picture in stamped)
    return tuple(each for each in found if each[1] != each[2])
