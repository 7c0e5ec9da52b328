"""Pictures rendered in another process: the recorded ones, and its death is named."""

import multiprocessing

import pytest

from foundation.recording.decoding import RecordingUnreadable
from testbed.recordings.pixels import RecordedStamp, RenderedAhead, RenderedPixels, checked, rendered_ahead
from tests.testbed.lockstep.recorded_run import FILES, RecordedRun
from tests.testbed.recordings.editing import all_of
from vision_pc.shell.recording import vision_recorder as topics
from vision_pc.shell.recording.vision_messages import FrameMessage

pytestmark = pytest.mark.realtime


@pytest.mark.slow("processes draw frames")
@pytest.mark.timeout(180)
def test_frames_come_in_their_turn_until_the_process_dies(
    recorded: RecordedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1})
    vision = recorded.directory / FILES[2]
    first, *later = (
        RecordedStamp(*(getattr(said, name) for name in RecordedStamp._fields))
        for said in all_of(vision, topics.FRAME, FrameMessage)
    )
    with rendered_ahead(RenderedPixels(recorded.directory / FILES[0]), vision) as pixels:
        assert isinstance(pixels, RenderedAhead)
        eyes = pixels.of(first)
        assert eyes is not None
        assert checked(first, eyes) == ()
        (process,) = (each for each in multiprocessing.active_children() if each.name == "rendering")
        process.kill()
        process.join(20.0)
        with pytest.raises(RecordingUnreadable) as refused:
            [pixels.of(stamp) for stamp in later]
        assert refused.value.cause == "recording.not_rendered"
    with pytest.raises(ValueError, match="out of turn"):
        RenderedAhead([first], multiprocessing.Pipe()[0]).of(later[0])
