"""Pictures rendered again in a process of their own, one frame ahead of who measures in them."""

import multiprocessing
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path

import cv2
import numpy as np

from foundation.recording.reading import RecordingUnreadable, messages
from testbed.recordings.pixels import Eyes, Pixels, RecordedStamp, RenderedPixels
from vision_pc.shell.recording import vision_recorder as topics
from vision_pc.shell.recording.vision_messages import FrameMessage

_END_S = 20.0


class RenderedAhead:
    """Implements ``Pixels`` over a process that renders the frames ``stamps`` in their order.

    ``cpu_s``: seconds of processor time of that process, once it has ended.
    """

    def __init__(self, stamps: Sequence[RecordedStamp], frames: Connection) -> None:
        self.cpu_s = 0.0
        self._stamps = iter(stamps)
        self._frames = frames

    def of(self, stamp: RecordedStamp) -> Eyes | None:
        """The frame, which must be the next; None where the plant did not record its capture.

        Raises RecordingUnreadable (``recording.not_rendered``) when the other process has died.
        """
        if stamp != next(self._stamps):
            raise ValueError(f"frame {stamp.frame_id} is asked for out of turn")
        shape = (stamp.height, stamp.width)
        try:
            if not self._frames.recv_bytes():
                return None
            left, right = (np.frombuffer(self._frames.recv_bytes(), np.uint8).reshape(shape) for _ in "lr")
        except (EOFError, ConnectionError) as error:
            why = f"frame {stamp.frame_id}: the process that renders has died"
            raise RecordingUnreadable("recording.not_rendered", why) from error
        return left, right

    def ended(self) -> None:
        """Read what the process says at its end."""
        with suppress(EOFError, ConnectionError, ValueError):
            self.cpu_s = float(self._frames.recv_bytes())


@contextmanager
def rendered_ahead(pixels: Pixels, recording: Path) -> Iterator[Pixels]:
    """``pixels``; those that must be rendered are by another process, where there is a second core."""
    if not isinstance(pixels, RenderedPixels) or len(os.sched_getaffinity(0)) < 2:
        yield pixels
        return
    said = (FrameMessage.FromString(record.data) for _, record in messages(recording, {topics.FRAME}))
    stamps = [RecordedStamp(*(getattr(each, name) for name in RecordedStamp._fields)) for each in said]
    spawned = multiprocessing.get_context("spawn")
    here, there = spawned.Pipe(duplex=False)
    process = spawned.Process(target=_render, args=(pixels, stamps, there), daemon=True, name="rendering")
    with here:
        process.start()
        there.close()
        made = RenderedAhead(stamps, here)
        try:
            yield made
            made.ended()
        finally:
            process.terminate()
            process.join(_END_S)


def _render(pixels: Pixels, stamps: Sequence[RecordedStamp], frames: Connection) -> None:
    """Render each frame and send it as soon as it is wanted: whether it could be, then both eyes."""
    cv2.setNumThreads(1)
    with suppress(BrokenPipeError, KeyboardInterrupt):
        for stamp in stamps:
            eyes = pixels.of(stamp)
            frames.send_bytes(b"" if eyes is None else b"rendered")
            for eye in eyes or ():
                frames.send_bytes(np.ascontiguousarray(eye).data.cast("B"))
        frames.send_bytes(str(time.process_time()).encode())
