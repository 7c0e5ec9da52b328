"""What a recording of the vision PC says of itself: its configuration, and what made it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from foundation.configuration import validated
from foundation.recording.beginning import session_entries
from foundation.recording.contents import contents
from foundation.recording.decoding import RecordingUnreadable
from nominal_arm.description import NominalArm
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.recording import vision_recorder as topics


class RecordedVision(NamedTuple):
    """What a recording says of itself. ``exact``: made by these very versions on this kind of machine.

    ``pictured``: its eyes had pictures.
    """

    path: Path
    config: VisionConfig
    arm: NominalArm
    session: Mapping[str, str]
    images: str
    exact: bool
    pictured: bool

    @property
    def run(self) -> Path:
        """The run's directory, where `longreach up` leaves it and the other processes' recordings."""
        return self.path.absolute().parent.parent


def recorded_vision(path: Path) -> RecordedVision:
    """The recording at ``path``.

    Raises OSError, RecordingUnreadable (``recording.not_vision``), ConfigurationError.
    """
    metadata = contents(path).metadata
    run = json.loads(metadata.get("run", {}).get("configuration", "{}"))
    if "vision" not in run:
        why = f"{path.name}: no recording of the vision PC, whose name is {topics.FILE}"
        raise RecordingUnreadable("recording.not_vision", why)
    config = validated(VisionConfig, run["vision"], path.name)
    arm = validated(NominalArm, run["arm"], path.name)
    session = metadata.get("session", {})
    here = session_entries("vision_pc", {})
    same = all(session.get(name) == value for name, value in here.items() if name not in ("id", "service"))
    pictured = session.get(topics.EYES) != topics.SIMULATED
    return RecordedVision(path, config, arm, session, run["vision"]["recording"]["images"], same, pictured)
