"""The emulated camera in simulated time: its exposures, and pictures for those who look."""

from collections.abc import Callable
from typing import NamedTuple

from plant_emulator.core.camera.exposures import STILL, CameraMotion, CameraView, Capture, Exposures, Shot
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from protocol.stereo_frame import FrameHeader, decode_header, encode_header
from testbed.scenarios.settings import Settings
from vision_pc.core.types import Image


class Exposure(NamedTuple):
    """One instant at which the camera exposes: what was true, and the frame that it makes of it.

    ``motion``: how camera and marker moved, where the camera's pictures depend on it.
    """

    truth: PlantTruth
    shot: Shot
    motion: CameraMotion | None = None


class SentFrame(NamedTuple):
    """A stereo pair as it arrives; the header's times are on the camera's clock, the simulated time."""

    header: FrameHeader
    left: Image
    right: Image


class CameraSide:
    """The camera of one world. ``viewers`` are called with every exposure; nothing is rendered unasked."""

    def __init__(self, settings: Settings) -> None:
        self.period_ns = round(1e9 / settings.scene.camera.rate_hz)
        self.viewers: list[Callable[[Exposure], None]] = []
        self._config = settings.scene.camera
        self._seed = settings.scene.seed
        self._scene = Scene(settings.scene)
        self._exposures = Exposures(self._config, self._seed)
        self._renderer: StereoCamera | None = None

    def expose(self, time_ns: int, plant: Plant) -> None:
        """Take the frame of ``time_ns``, a multiple of the period, and show it to the viewers."""
        truth = plant.truth()
        motion = plant.motion() if self._config.shows_motion else None
        view = CameraView(truth.X_WC, truth.X_WM)
        number = time_ns // self.period_ns
        capture = Capture(number, time_ns, view, STILL if motion is None else motion)
        exposure = Exposure(truth, self._exposures.shot(capture, plant.faults.in_force()), motion)
        for viewer in list(self.viewers):
            viewer(exposure)

    @property
    def renderer(self) -> StereoCamera:
        """What renders this camera's pictures, made when first asked for."""
        if self._renderer is None:
            self._renderer = StereoCamera(self._config, self._scene, self._seed)
        return self._renderer

    def photograph(self, exposure: Exposure) -> SentFrame:
        """The frame of ``exposure`` with its pictures, through the stream's own header."""
        config, shot = self._config, exposure.shot
        header = FrameHeader(
            frame_id=shot.frame_id,
            capture_ns=shot.capture_ns,
            send_ns=exposure.truth.time_ns,
            width=config.width_px,
            height=config.height_px,
            exposure_us=config.exposure_us,
            flags=0,
        )
        left, right = self.renderer.take(shot)
        return SentFrame(decode_header(encode_header(header)), left, right)
