"""The service's recording, opened where --record-dir says."""

import time
from pathlib import Path

from foundation.event_log import EventLog
from foundation.recording.session import session_entries
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.recording.vision_recorder import FILE, VisionRecorder


def open_recording(
    directory: Path | None, config: VisionConfig, arm: NominalArm, log: EventLog
) -> VisionRecorder | None:
    """A recorder of ``vision.mcap`` in ``directory`` that is told all events of ``log``; None without one.

    Raises ConfigurationError when the file cannot be made.
    """
    if directory is None:
        return None
    run = {"arm": arm.model_dump(mode="json"), "vision": config.model_dump(mode="json")}
    try:
        recorder = VisionRecorder(
            directory / FILE, config, run, session_entries("vision_pc"), time.monotonic_ns
        )
    except OSError as error:
        why = f"--record-dir {directory}: {FILE}: {error.strerror}"
        raise ConfigurationError("configuration.recording", why) from error
    recorder.failed = lambda why: log.write(
        "recording_failed", "error", cause="recording.unwritable", detail=why
    )
    log.listener = recorder.event
    return recorder
