"""Pictures rendered in another process where there is a second core."""

import pytest

from testbed.recordings.pixels import RenderedPixels
from testbed.recordings.rendering import rendered_ahead
from tests.testbed.lockstep.recorded_run import FILES, RecordedRun


def test_on_one_core_nothing_is_started(recorded: RecordedRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0})
    inline = RenderedPixels(recorded.directory / FILES[0])
    with rendered_ahead(inline, recorded.directory / FILES[2]) as pixels:
        assert pixels is inline
