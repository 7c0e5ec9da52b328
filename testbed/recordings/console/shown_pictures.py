"""The picture of any moment of a recording: as it was kept, or rendered again, for a person to look at."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.reader import make_reader

from foundation.recording.reading import RecordingUnreadable
from testbed.recordings.console.timeline import Timeline
from testbed.recordings.pixels import RenderedPixels, checked
from vision_pc.core.types import Image
from vision_pc.shell.recording.vision_recorder import IMAGES
from vision_pc.shell.rest.console.pictures import encoded

AS_KEPT, LEFT_KEPT, RENDERED = "as kept", "the left eye, as kept", "rendered again"


class ShownPicture(NamedTuple):
    """Both eyes as JPEG, the right one empty where it is not known; ``note``: what is not as recorded."""

    frame_id: int
    capture_ns: int
    left: bytes
    right: bytes
    note: str = ""


class ShownPictures:
    """Pictures of the frames that were measured in, or of those that were kept of them.

    ``source`` says where they come from, or why there are none.
    """

    def __init__(self, timeline: Timeline, truth: Path) -> None:
        """``truth``: the plant's recording of the session, for pictures that were not kept."""
        self._of = timeline
        self._rendered: RenderedPixels | None = None
        self._newest: tuple[int, ShownPicture | None] = (0, None)
        self._kept = timeline.recording.images if timeline.images.times_ns else "none"
        self.source = self._chosen(truth)

    def of(self, time_ns: int) -> ShownPicture | None:
        """The newest by ``time_ns``; None where there is none, or where its capture is not in the truth.

        Raises RecordingUnreadable (``recording.picture_unreadable``).
        """
        series = self._of.images if self.source in (AS_KEPT, LEFT_KEPT) else self._of.frames
        count = 0 if self.source.startswith("none") else series.count(time_ns)
        if count != self._newest[0]:
            self._newest = count, self._made(count - 1) if count else None
        return self._newest[1]

    def _chosen(self, truth: Path) -> str:
        why = f"there is no {truth}"
        readable = self._kept != "none" and self._indexed()
        if readable and self._kept == "raw":
            return AS_KEPT
        if not self._of.recording.pictured:
            return "none: these eyes had no pictures"
        if truth.is_file():
            try:
                self._rendered = RenderedPixels(truth)
                return RENDERED
            except RecordingUnreadable as error:
                why = str(error)
        if readable:
            return LEFT_KEPT
        return f"none: {why}" if self._kept == "none" else "none: `longreach recording recover` it first"

    def _indexed(self) -> bool:
        """Whether the file was closed, so that its pictures can be found in it."""
        with self._of.recording.path.open("rb") as stream:
            try:
                return make_reader(stream).get_summary() is not None
            except McapError:
                return False

    def _made(self, index: int) -> ShownPicture | None:
        if self._rendered is not None:
            return self._render(index)
        try:
            return self._read(index)
        except (OSError, McapError, DecodeError) as error:
            raise RecordingUnreadable("recording.picture_unreadable", str(error)) from error

    def _render(self, index: int) -> ShownPicture | None:
        stamp = self._of.frames.items[index]
        eyes = self._rendered.of(stamp) if self._rendered is not None else None
        if eyes is None:
            return None
        differing = " and ".join(name for name, _, _ in checked(stamp, eyes))
        note = f"{differing} eye not as recorded" if differing else ""
        return ShownPicture(stamp.frame_id, stamp.capture_ns, *encoded(*eyes), note)

    def _read(self, index: int) -> ShownPicture | None:
        capture_ns = self._of.images.items[index]
        left, right = (self._message(eye, capture_ns) for eye in range(len(IMAGES)))
        frame_id = self._of.frame_at(capture_ns)
        if left is None:
            return None
        if self._kept == "jpeg":
            kept = bytes(CompressedImage.FromString(left).data)
            return ShownPicture(frame_id, capture_ns, kept, b"")
        if right is None:
            return None
        return ShownPicture(frame_id, capture_ns, *encoded(_pixels(left), _pixels(right)))

    def _message(self, eye: int, capture_ns: int) -> bytes | None:
        log_ns = self._of.image_logs.get((eye, capture_ns))
        if log_ns is None:
            return None
        with self._of.recording.path.open("rb") as stream:
            reader = make_reader(stream)
            for _, _, said in reader.iter_messages(
                [IMAGES[eye]], starting_at=log_ns, ending_before=log_ns + 1
            ):
                return bytes(said.data)
        return None


def _pixels(data: bytes) -> Image:
    image = RawImage.FromString(data)
    return np.frombuffer(image.data, dtype=np.uint8).reshape(image.height, image.width)
