"""The service's recording, opened where --record-dir says."""

import time
from pathlib import Path

from foundation.event_log import EventLog
from foundation.live.feed import LiveFeed, Opened
from foundation.recording.beginning import session_entries
from foundation.recording.messages import RecordingThread
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.recording.vision_recorder import FILE, VisionRecorder


def open_recording(
    directory: Path | None, config: VisionConfig, arm: NominalArm, log: EventLog, feed: LiveFeed | None = None
) -> VisionRecorder | None:
    """A recorder of ``vision.mcap`` in ``directory`` and of what ``feed`` shows, that is told all events of
    ``log``; None without either.

    Raises ConfigurationError when the file cannot be made.
    """
    if directory is None and feed is None:
        return None
    made: Opened = RecordingThread if feed is None else feed.opened(directory is not None)
    run = {"arm": arm.model_dump(mode="json"), "vision": config.model_dump(mode="json")}
    try:
        recorder = VisionRecorder(
            (directory or Path()) / FILE, config, run, session_entries("vision_pc"), time.monotonic_ns, made
        )
    except OSError as error:
        why = f"--record-dir {directory}: {FILE}: {error.strerror}"
        raise ConfigurationError("configuration.recording", why) from error
    recorder.failed = lambda why: log.write(
        "recording_failed", "error", cause="recording.unwritable", detail=why
    )
    log.listener = recorder.event
    return recorder
