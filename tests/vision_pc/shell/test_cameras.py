"""Camera sources against a sender and a film; every kind of failure told by its cause."""

import asyncio
import socket
import threading
import time
from collections.abc import AsyncIterator, Iterable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from protocol.errors import FrameRefused, LinkLost
from protocol.stereo_frame import FrameHeader, encode_header
from tests.vision_pc.perception.test_rectification import raw_camera
from tests.vision_pc.shell.loopback_controller import until
from vision_pc.config.camera import CameraSettings
from vision_pc.config.choices import LensModel
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception.rectification import Rectifier
from vision_pc.core.types import StereoPair
from vision_pc.shell.cameras import CameraSource, open_camera, uvc
from vision_pc.shell.cameras.stream import StreamClock

pytestmark = pytest.mark.realtime

WIDTH, HEIGHT = 96, 64
HOUR_NS = 3_600_000_000_000


class Sender:
    """A camera stream that sends what a test asks for, on a clock one hour ahead."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._clients: list[socket.socket] = []
        self._accepted = threading.Event()
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            self._clients.append(client)
            self._accepted.set()

    def wait(self) -> None:
        assert self._accepted.wait(5.0)
        self._accepted.clear()

    def send(self, frame_id: int, grey: int | None = None, size: tuple[int, int] = (WIDTH, HEIGHT)) -> int:
        """Send one frame, on average of value ``grey``; the time on this machine at which it was captured."""
        captured_ns = time.monotonic_ns() - 20_000_000
        header = FrameHeader(
            frame_id, captured_ns + HOUR_NS, time.monotonic_ns() + HOUR_NS, *size, exposure_us=4000, flags=0
        )
        value = frame_id % 200 if grey is None else grey
        self.send_bytes(
            encode_header(header)
            + bytes([value]) * (size[0] * size[1])
            + bytes([value + 1]) * (size[0] * size[1])
        )
        return captured_ns

    def send_bytes(self, data: bytes) -> None:
        self._clients[-1].sendall(data)

    def close(self) -> None:
        self._listener.close()
        for client in self._clients:
            client.close()


@pytest.fixture
def sender() -> Iterator[Sender]:
    it = Sender()
    yield it
    it.close()


def settings(config: VisionConfig, source: str, **changes: object) -> CameraSettings:
    base = config.camera.model_dump() | {
        "source": source,
        "width_px": WIDTH,
        "height_px": HEIGHT,
        "stale_ms": 400.0,
        "frozen_frames": 3,
    }
    return CameraSettings.model_validate(base | changes)


@asynccontextmanager
async def opened(camera_settings: CameraSettings) -> AsyncIterator[CameraSource]:
    camera = open_camera(camera_settings)
    await camera.start()
    try:
        yield camera
    finally:
        await camera.close()


def stream_settings(config: VisionConfig, port: int) -> CameraSettings:
    return settings(config, "stream", stream={"host": "127.0.0.1", "port": port, "reconnect_ms": 20})


async def test_stream_gives_the_newest_pair_on_this_machines_clock(
    config: VisionConfig, sender: Sender
) -> None:
    async with opened(stream_settings(config, sender.port)) as camera:
        await asyncio.to_thread(sender.wait)
        sender.send(7)
        first = await camera.frame_after(0)
        captured_ns = sender.send(11)
        pair = await camera.frame_after(first.capture_ns)
        assert (first.frame_id, pair.frame_id) == (7, 11)
        assert abs(pair.capture_ns - captured_ns) < 5_000_000
        assert pair.left.shape == (HEIGHT, WIDTH)
        assert (pair.left == 11).all()
        assert (pair.right == 12).all()
        status = camera.status()
        assert (status.connected, status.frames, status.dropped, status.reconnects) == (True, 2, 3, 0)
        assert status.age_ms is not None


async def test_held_pictures_are_not_written_over(config: VisionConfig, sender: Sender) -> None:
    async with opened(stream_settings(config, sender.port)) as camera:
        await asyncio.to_thread(sender.wait)
        held: list[StereoPair] = []
        for number in range(1, 7):
            sender.send(number)
            held.append(await camera.frame_after(held[-1].capture_ns if held else 0))
        assert [int(pair.left[0, 0]) for pair in held] == [1, 2, 3, 4, 5, 6]


async def test_silent_stream_is_told_as_lost_and_found_again(config: VisionConfig, sender: Sender) -> None:
    async with opened(stream_settings(config, sender.port)) as camera:
        await asyncio.to_thread(sender.wait)
        sender.send(1)
        pair = await camera.frame_after(0)
        with pytest.raises(LinkLost) as lost:
            await camera.frame_after(pair.capture_ns)
        assert lost.value.cause == "link.camera_silent"
        assert camera.status().trouble == "link.camera_silent"
        await asyncio.to_thread(sender.wait)  # it connects anew by itself
        sender.send(2)
        assert (await camera.frame_after(pair.capture_ns)).frame_id == 2
        assert camera.status().reconnects == 1


async def test_frozen_picture_is_told_although_frames_arrive(config: VisionConfig, sender: Sender) -> None:
    async with opened(stream_settings(config, sender.port)) as camera:
        await asyncio.to_thread(sender.wait)
        sender.send(1)
        pair = await camera.frame_after(0)

        async def repeat() -> None:
            for number in range(2, 40):
                sender.send(number, grey=1)
                await asyncio.sleep(0.02)

        for number in range(2, 5):  # three more alike: the limit
            sender.send(number, grey=1)
        await until(lambda: camera.status().trouble == "link.camera_frozen")
        repeating = asyncio.create_task(repeat())
        with pytest.raises(LinkLost) as lost:
            await camera.frame_after(pair.capture_ns)
        assert lost.value.cause == "link.camera_frozen"
        await repeating
        sender.send(50, grey=2)
        assert (await camera.frame_after(pair.capture_ns)).frame_id == 50


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (b"\x00" * 200, "frame.bad_magic"),
        (
            encode_header(FrameHeader(1, 1, 1, WIDTH, HEIGHT, 4000, 0))[:-1] + b"\x55",
            "frame.bad_crc",
        ),
    ],
)
async def test_stream_that_lost_its_place_is_left(
    config: VisionConfig, sender: Sender, data: bytes, cause: str
) -> None:
    async with opened(stream_settings(config, sender.port)) as camera:
        await asyncio.to_thread(sender.wait)
        sender.send_bytes(data)
        await asyncio.to_thread(sender.wait)
        sender.send(3)
        assert (await camera.frame_after(0)).frame_id == 3
        assert camera.status().reconnects == 1


async def test_pictures_of_another_size_are_refused(config: VisionConfig, sender: Sender) -> None:
    camera_settings = stream_settings(config, sender.port)
    slow = camera_settings.stream.model_copy(update={"reconnect_ms": 10_000.0})
    async with opened(camera_settings.model_copy(update={"stream": slow})) as camera:
        await asyncio.to_thread(sender.wait)
        sender.send(1, size=(WIDTH, 2 * HEIGHT))
        with pytest.raises(
            LinkLost, match=f"are {WIDTH}×{2 * HEIGHT} px, configured are {WIDTH}×{HEIGHT}"
        ) as lost:
            await camera.frame_after(0)
        assert lost.value.cause == "frame.wrong_size"


async def test_missing_camera_is_named(config: VisionConfig) -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    async with opened(stream_settings(config, port)) as camera:
        with pytest.raises(LinkLost) as lost:
            await camera.frame_after(0)
        assert lost.value.cause == "link.camera_missing"
        assert not camera.status().connected


def test_stream_clock_takes_off_every_delay_but_the_least() -> None:
    clock = StreamClock()
    generator = np.random.default_rng(4)
    delays_ns = (300_000 + generator.exponential(5e6, 300)).astype(int)
    errors = []
    for k, delay_ns in enumerate(delays_ns.tolist()):
        send_ns = 50_000_000 * k
        local = clock.local_ns(send_ns - 7_000_000, send_ns, send_ns + HOUR_NS + delay_ns)
        errors.append(local - (send_ns - 7_000_000 + HOUR_NS))
    assert max(errors[50:]) < 1_000_000
    assert min(errors) >= 300_000


def film(path: Path, pictures: Iterable[np.ndarray], rate_hz: float = 30) -> Path:
    """A film of grey ``pictures`` at ``path``."""
    shown = [cv2.cvtColor(each, cv2.COLOR_GRAY2BGR) for each in pictures]
    height, width = shown[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate_hz, (width, height))
    for each in shown:
        writer.write(each)
    writer.release()
    return path


async def test_a_film_is_played_at_its_own_rate_over_and_over(config: VisionConfig, tmp_path: Path) -> None:
    """A look takes longer than a short film, which was over in a moment and then no camera for a second."""
    rate_hz, lefts = 20, [np.full((HEIGHT, WIDTH), grey, np.uint8) for grey in (40, 80, 120)]
    path = film(tmp_path / "film.avi", [np.hstack([left, left // 2]) for left in lefts], rate_hz)
    async with opened(settings(config, "uvc", uvc={"device": str(path)}, frozen_frames=0)) as camera:
        pairs = []
        async for pair in camera.pairs():
            pairs.append(pair)
            if len(pairs) > 6:
                break
    between_s = 1e-9 * (pairs[-1].capture_ns - pairs[0].capture_ns) / (pairs[-1].frame_id - pairs[0].frame_id)
    assert between_s > 0.5 / rate_hz
    assert {round(float(pair.left.mean()), -1) for pair in pairs} == {40.0, 80.0, 120.0}
    assert {round(float(pair.right.mean()), -1) for pair in pairs} == {20.0, 40.0, 60.0}
    assert pairs[0].left.flags["C_CONTIGUOUS"]


async def test_raw_pairs_come_rectified(config: VisionConfig, sender: Sender) -> None:
    raw = raw_camera(LensModel.BROWN_CONRADY, (WIDTH, HEIGHT), 60.0)
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    pair = StereoPair((u * 2).astype(np.uint8), (v * 3).astype(np.uint8), 1, 1)
    expected = Rectifier(raw)(pair)
    known = stream_settings(config, sender.port).model_dump() | {"calibration": raw.model_dump()}
    async with opened(CameraSettings.model_validate(known)) as camera:
        await asyncio.to_thread(sender.wait)
        now_ns = time.monotonic_ns()
        header = FrameHeader(1, now_ns, now_ns, WIDTH, HEIGHT, 4000, 0)
        sender.send_bytes(encode_header(header) + pair.left.tobytes() + pair.right.tobytes())
        found = await camera.frame_after(0)
        np.testing.assert_array_equal(found.left, expected.left)
        np.testing.assert_array_equal(found.right, expected.right)
    assert (found.left != pair.left).any()


def test_pictures_of_every_kind_become_grey() -> None:
    level = np.full((4, 6), 77, dtype=np.uint8)
    bgr = cv2.cvtColor(level, cv2.COLOR_GRAY2BGR)
    yuyv = np.dstack([level, np.full_like(level, 128)])
    for picture in (level, level[..., None], bgr, cv2.cvtColor(bgr, cv2.COLOR_BGR2BGRA), yuyv,
                    level.astype(np.uint16) * 256):  # fmt: skip
        np.testing.assert_array_equal(uvc.grey(np.asarray(picture)), level)
    coloured = np.zeros((2, 2, 3), dtype=np.uint8)
    coloured[..., 1] = 255
    assert uvc.grey(coloured)[0, 0] == 150  # green weighs 0.587
    with pytest.raises(FrameRefused, match="5 channels of uint8 came; grey, BGR"):
        uvc.grey(np.zeros((2, 2, 5), dtype=np.uint8))
    with pytest.raises(FrameRefused, match="5 px wide came"):
        uvc.halves(np.zeros((2, 5), dtype=np.uint8), "film.avi")
