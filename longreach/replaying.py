"""Vision's recording run again from Python, compared with what was recorded."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from testbed.recordings.decision_replay import DecisionReplay
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
    """Vision's perception, where pictures are to be had, and its programs over ``file`` (``vision.mcap``).

    ``truth``: the plant's recording to render pictures from; None: that of the same run, where ``file`` holds
    no pictures. Settings are those of the recording; `longreach replay --set` tries others.
    Raises RecordingUnreadable, ConfigurationError, OSError.
    """
    recording = recorded_vision(Path(file), None)
    alike: dict[str, int] = {}
    recorded: dict[str, int] = {}
    differences, damages = [], 0
    replays: list[PerceptionReplay | DecisionReplay] = [DecisionReplay(recording)]
    if recording.pictured:
        pixels = pixels_for(recording, None if truth is None else Path(truth))
        replays.insert(0, PerceptionReplay(recording, pixels, lambda *_: None))
    for each in replays:
        compared = each.run()
        recorded |= compared.of
        alike |= {kind: compared.alike[kind] for kind in compared.of}
        damages = max(damages, len(each.damages))
        if compared.first is not None:
            differences.append(compared.first.in_words())
    return Replay(alike, recorded, next(iter(differences), ""), damages)
