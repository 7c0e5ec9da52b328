"""What the recorders of all services share: how one is opened, its topics by name, its end told once."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from foundation.recording.mcap_file import Entries, Topic
from foundation.recording.messages import RecordSink
from protocol.errors import ConfigurationError

OpenSink = Callable[[Path, Sequence[Topic], Entries], RecordSink]


class ServiceRecorder:
    """Puts messages on topics. ``failed`` gets the reason, once, when nothing more can be written."""

    def __init__(
        self,
        path: Path,
        topics: Sequence[Topic],
        run: Mapping[str, Any],
        session: Mapping[str, str],
        made: OpenSink,
    ) -> None:
        """Create ``path``; ``run`` and ``session`` are metadata, ``made`` opens the file.

        Raises ConfigurationError (``configuration.recording``) when it cannot be written.
        """
        configuration = json.dumps(run, separators=(",", ":"))
        entries = {"run": {"configuration": configuration}, "session": dict(session)}
        try:
            self.sink = made(path, topics, entries)
        except OSError as error:
            why = f"--record-dir {path.parent}: {path.name}: {error.strerror}"
            raise ConfigurationError("configuration.recording", why) from error
        self.failed: Callable[[str], object] = str
        self._failure_logged = False
        self._numbers = {topic.name: number for number, topic in enumerate(topics)}

    def tell_failure(self, write: Callable[..., object]) -> None:
        """Have a log say when nothing more can be written; ``write`` is its method."""
        self.failed = lambda why: write("recording_failed", "error", cause="recording.unwritable", detail=why)

    def put(self, topic: str, message: Any, log_ns: int, stamp_ns: int, *, wanted: bool = False) -> None:
        """Record ``message``, which must not change afterwards; never drop what is ``wanted``."""
        if self.sink.failure and not self._failure_logged:
            self._failure_logged = True
            self.failed(f"{self.sink.path}: {self.sink.failure}")
        self.sink.put(self._numbers[topic], message, log_ns, stamp_ns, wanted=wanted)

    def close(self) -> None:
        """Write what waits and the summary, and close the file. What can no longer be written is left out."""
        self.sink.close()
