"""The service's eyes put together: a camera, a thread to compute in, and the record of what was seen."""

from typing import NamedTuple

from foundation.event_log import EventLog
from vision_pc.application.annotate import annotated, png
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.ports import FrameSource, Runtime, StateSource
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.types import FrameObservation, Look, StereoPair, WatchHealth
from vision_pc.shell.monotonic_clock import MonotonicClock
from vision_pc.shell.worker import BatchWorker, TaskBackground


class LookRecord:
    """Implements ``EyesRecord``: pictures go into the record directory, if there is one."""

    def __init__(self, config: VisionConfig, log: EventLog, worker: BatchWorker) -> None:
        self._camera = calibration(config.camera)
        self._clearance_m = config.programs.positioning.clearance_m
        self._log = log
        self._worker = worker
        self._looks = 0

    def pictured(self, frame: StereoPair, observation: FrameObservation) -> None:
        """Have the worker write the look's last picture, with its detections."""
        directory = self._log.record_dir
        if directory is None:
            return
        self._looks += 1
        path = directory / f"look-{self._looks:04d}.png"

        def write() -> None:
            try:
                path.write_bytes(png(annotated(frame, observation, self._camera, self._clearance_m)))
            except OSError as error:
                fields = {"cause": "recording.unwritable", "detail": f"{path}: {error.strerror}"}
                self._log.write("picture_failed", "error", **fields)

        self._worker.submit(write)

    def looked(self, look: Look) -> None:
        """Do nothing: the station writes every look of its programs."""

    def watched(self, health: WatchHealth) -> None:
        """Write what the watch missed."""
        self._log.write("watched", **health._asdict())


class OpenedEyes(NamedTuple):
    """Eyes and the worker that they compute in; its ``close`` waits for the last picture to be written."""

    eyes: CameraEyes
    worker: BatchWorker


def open_eyes(
    camera: FrameSource[StereoPair], states: StateSource, config: VisionConfig, log: EventLog
) -> OpenedEyes:
    """Eyes on ``camera`` within the running event loop."""
    clock, worker = MonotonicClock(), BatchWorker()
    runtime = Runtime(clock, worker, TaskBackground(clock))
    return OpenedEyes(CameraEyes(camera, states, config, runtime, LookRecord(config, log, worker)), worker)
