"""Vision's recording run again from Python, compared with what was recorded."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from testbed.recordings.perception_replay import PerceptionReplay, pixels_for
from testbed.recordings.recorded_vision import recorded_vision


class Replay(NamedTuple):
    """What came out again: ``alike`` and ``recorded`` messages of each kind, the first that differs in words
    (empty: none), and how many damaged places of the file were not read.
    """

    alike: Mapping[str, int]
    recorded: Mapping[str, int]
    first_difference: str
    damages: int

    @property
    def identical(self) -> bool:
        """Whether everything came out as it was recorded."""
        return dict(self.alike) == dict(self.recorded) and not self.damages


def replay(file: Path | str, truth: Path | str | None = None) -> Replay:
    """Vision's perception over ``file`` (``vision.mcap``).

    ``truth``: the plant's recording to render pictures from; None: that of the same run, where ``file`` holds
    no pictures. Settings are those of the recording.
    Raises RecordingUnreadable, ConfigurationError, OSError.
    """
    recording = recorded_vision(Path(file))
    made = PerceptionReplay(recording, pixels_for(recording, None if truth is None else Path(truth)))
    compared = made.run()
    difference = "" if compared.first is None else compared.first.in_words()
    return Replay(compared.alike, compared.of, difference, len(made.damages))
