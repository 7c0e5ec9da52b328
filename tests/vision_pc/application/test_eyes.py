"""Eyes on a camera: fresh pairs only, at rest only, in a thread of their own; failures by name."""

import asyncio
import io
import threading
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest

from foundation.configuration import load
from foundation.event_log import EventLog
from protocol.errors import LinkLost, RequestRefused
from protocol.faults import CommandCode, GroupState
from protocol.reference_messages import ANY_ARM
from tests.vision_pc.conftest import VISION_YAML
from tests.vision_pc.rendering import Marker, draw_marker, draw_wall, facing, finish, wall_texture
from tests.vision_pc.shell.loopback_controller import LoopbackController, until
from tests.vision_pc.synthetic import Q_START, SyntheticRig, draw, forward
from vision_pc.application import camera_eyes
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.config.vision import LinkSettings, VisionConfig
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.se3 import transform
from vision_pc.core.targets.sighting import Click, Sighted
from vision_pc.core.targets.target import Candidate, TargetObservation, TargetRefused
from vision_pc.core.types import StereoPair
from vision_pc.shell.camera_eyes import OpenedEyes, ProcessClock, open_eyes
from vision_pc.shell.cameras import CameraSource
from vision_pc.shell.link.udp_endpoint import UdpEndpoint

pytestmark = pytest.mark.realtime

X_CM = facing(0.15, 0.05, 0.5)
X_CO = facing(-0.1, -0.05, 1.0)
PERIOD_S = 0.05


def object_markers(X_CO: np.ndarray) -> tuple[Marker, ...]:
    places = ((1, -0.2, 0.0), (2, 0.2, 0.0), (3, 0.0, 0.2))
    return tuple(Marker(i, 0.12, X_CO @ transform(np.eye(3), [x, y, 0.0])) for i, x, y in places)


class PlayedCamera(CameraSource):
    """Plays ``pairs`` round and round at 20 a second, stamped as they come, until ``silent`` is set."""

    silent = False

    def play(self, pairs: list[StereoPair]) -> None:
        self.pairs_to_play = pairs

    def _produce(self) -> None:
        self._is_there()
        count = 0
        while not self._stop.wait(PERIOD_S):
            if not self.silent:
                pair = self.pairs_to_play[count % len(self.pairs_to_play)]
                self._deliver(pair._replace(capture_ns=time.monotonic_ns(), frame_id=count))
            count += 1


class Pictures(NamedTuple):
    """Pairs at rest with and without the object, and a camera that moves 10 mm a picture along the wall."""

    both: list[StereoPair]
    alone: list[StereoPair]
    moving: list[StereoPair]


@pytest.fixture(scope="module")
def pictures() -> Pictures:
    """Noise is drawn anew in each pair."""
    camera = calibration(load(VisionConfig, VISION_YAML).camera)
    generator = np.random.default_rng(5)
    texture = wall_texture(1, 30.0, 1500)
    tool = Marker(0, 0.1, X_CM)

    def render(markers: tuple[Marker, ...], moved: float = 0.0) -> StereoPair:
        X_CW = transform(np.diag([1.0, -1.0, -1.0]), [-moved, 0.0, 1.005])
        eyes = []
        for eye in (camera.left, camera.right):
            picture = draw_wall(eye, (camera.height, camera.width), texture, 0.002, X_CW)
            for marker in markers:
                draw_marker(picture, eye, marker, samples=2)
            eyes.append(finish(picture, generator))
        return StereoPair(eyes[0], eyes[1], 0, 0)

    return Pictures(
        [render((*object_markers(X_CO), tool)) for _ in range(3)],
        [render((tool,)) for _ in range(2)],
        [render((), 0.01 * k) for k in range(6)],
    )


class Bench:
    def __init__(self, camera: PlayedCamera, controller: LoopbackController, link: ReferenceLink,
                 opened: OpenedEyes) -> None:  # fmt: skip
        self.camera, self.controller, self.link = camera, controller, link
        self.eyes, self.worker, _ = opened


@pytest.fixture
async def bench(config: VisionConfig, pictures: Pictures, tmp_path: Path) -> AsyncIterator[Bench]:
    rig = SyntheticRig(draw(np.random.default_rng(0)), 0, rate_hz=100.0)
    controller = LoopbackController(rig, link_timeout_ms=30_000)
    await controller.start()
    log = EventLog("vision_pc", io.StringIO())
    log.record_in(tmp_path)
    endpoint = UdpEndpoint(
        LinkSettings(port=controller.port, state_period_ms=10), ANY_ARM, log, ProcessClock()
    )
    link = endpoint.link
    await endpoint.start()
    played = PlayedCamera(config.camera.model_copy(update={"stale_ms": 400.0}))
    played.play(pictures.both)
    await played.start()
    opened = open_eyes(played, link, config, log)
    await until(lambda: link.connected and played.newest)
    yield Bench(played, controller, link, opened)
    opened.worker.close()
    await played.close()
    await endpoint.close()
    await controller.stop()
    log.close()


async def test_a_look_measures_fresh_pairs(bench: Bench) -> None:
    began_ns = time.monotonic_ns()
    look = await bench.eyes.look(4)
    assert look.time_ns > began_ns
    assert np.allclose(look.X_CM[:3, 3], X_CM[:3, 3], atol=1e-3)
    assert np.allclose(look.X_CO[:3, 3], X_CO[:3, 3], atol=3e-3)
    assert np.allclose(look.X_BT, forward(Q_START), atol=1e-9)
    assert (look.frames, look.failed_tool, look.failed_object) == (4, 0, 0)


async def test_the_loop_stays_free_while_the_thread_looks(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, measured = bench.worker.run, 0
    loop = asyncio.get_running_loop()

    async def waiting_for_the_loop(work: Callable[[], Any]) -> Any:
        def once_it_turned() -> Any:
            nonlocal measured
            turned = threading.Event()
            loop.call_soon_threadsafe(turned.set)
            assert turned.wait(20.0), "the loop stands still while a picture is measured"
            measured += 1
            return work()

        return await run(once_it_turned)

    monkeypatch.setattr(bench.worker, "run", waiting_for_the_loop)
    await bench.eyes.look(6)
    assert measured >= 6


async def test_looks_are_refused_while_the_arm_moves(bench: Bench) -> None:
    await bench.link.command(CommandCode.ENABLE)
    bench.controller.group = GroupState.MOVING
    bench.controller.motion = [(forward(Q_START), forward(Q_START), 10_000)]
    await bench.link.next_state()
    await bench.link.next_state()
    with pytest.raises(RequestRefused) as refused:
        await bench.eyes.look(2)
    assert refused.value.cause == "refused.moving"


async def test_a_click_is_refused_where_what_was_clicked_has_moved_since(
    bench: Bench, pictures: Pictures, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vision_pc.application.camera_eyes._KEPT_NS", 60 * 10**9)  # of a loaded machine, too
    click = Click(np.array([500.0, 150.0]), "plane")
    shown = await bench.eyes.pair_after(0)
    assert bench.eyes.seen() is None
    assert (await bench.eyes.target_at(click, shown.frame_id)).frame_id == shown.frame_id
    seen = bench.eyes.seen()
    assert seen is not None
    assert seen.observation.X_CM is not None, "how far the tool has to go is told of the first click too"
    bench.camera.play(pictures.moving[3:4])
    await bench.camera.frame_after(time.monotonic_ns())
    with pytest.raises(TargetRefused, match=r"something else|moved by 1. px") as refused:
        await bench.eyes.target_at(click, shown.frame_id)
    assert refused.value.cause == "target.moves"


@pytest.mark.slow("a person's time is waited for")
async def test_who_is_asked_for_the_other_eye_has_time_to_find_the_place_there(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = camera_eyes.at_click

    def ambiguous_alone(sighted: Sighted, click: Click) -> TargetObservation:
        if click.other is None:
            raise TargetRefused("target.ambiguous", "look alike", (Candidate((5.0, 6.0), np.zeros(3)),))
        return measured(sighted, click._replace(other=None))

    monkeypatch.setattr(camera_eyes, "at_click", ambiguous_alone)
    click = Click(np.array([500.0, 150.0]), "plane")
    shown = await bench.eyes.pair_after(0)
    with pytest.raises(TargetRefused, match="look alike"):
        await bench.eyes.target_at(click, shown.frame_id)
    newest = shown
    for _ in range(40):  # more than are kept for a first click
        newest = await bench.eyes.pair_after(newest.capture_ns)
    answer = click._replace(other=np.array([450.0, 150.0]))
    assert (await bench.eyes.target_at(answer, shown.frame_id)).frame_id == shown.frame_id
    for late in (click, answer):  # it was answered: the picture is kept no longer
        with pytest.raises(TargetRefused) as refused:
            await bench.eyes.target_at(late, shown.frame_id)
        assert refused.value.cause == "target.frame_too_old"


async def test_a_silent_camera_is_told_and_no_old_picture_is_used(bench: Bench) -> None:
    bench.camera.silent = True
    with pytest.raises(LinkLost) as lost:
        await bench.eyes.look(3)
    assert lost.value.cause == "link.camera_silent"
    assert not bench.eyes.status().connected
    bench.camera.silent = False
    await until(lambda: bench.eyes.status().connected)
    await bench.eyes.look(2)


async def test_a_watch_begins_before_its_body_and_ends_after_it(bench: Bench) -> None:
    async with bench.eyes.watch(markers=True, odometry=True) as watch:
        assert len(watch.samples) == 1
        await asyncio.sleep(0.4)
        left_ns = time.monotonic_ns()
    samples = watch.samples
    assert samples[-1].time_ns >= left_ns
    assert samples[-2].time_ns < left_ns
    assert len(samples) >= 3
    times = [sample.time_ns for sample in samples]
    assert times == sorted(set(times))
    for sample in samples:
        assert sample.X_C0C is not None
        assert np.allclose(sample.X_C0C, np.eye(4), atol=1e-3)
        assert sample.X_CM is not None
        assert np.allclose(sample.X_CM[:3, 3], X_CM[:3, 3], atol=2e-3)
    health = watch.health
    assert (health.frames, health.odometry_lost) == (len(samples), 0)


async def test_an_error_in_the_body_ends_the_watch_at_once(bench: Bench) -> None:
    async def watch() -> None:
        async with bench.eyes.watch(markers=False, odometry=True):
            raise RequestRefused("refused.stopped", "the motion was stopped")

    with pytest.raises(RequestRefused):
        await watch()
    assert not [task for task in asyncio.all_tasks() if "_gather" in repr(task)]


async def test_a_camera_lost_during_a_watch_fails_it(bench: Bench) -> None:
    async def watch() -> None:
        async with bench.eyes.watch(markers=False, odometry=True):
            bench.camera.silent = True
            await asyncio.sleep(0.6)

    with pytest.raises(LinkLost) as lost:
        await watch()
    assert lost.value.cause == "link.camera_silent"


async def test_the_picture_is_the_newest_one_with_its_detections(bench: Bench) -> None:
    shown = cv2.imdecode(np.frombuffer(await bench.eyes.latest_png(), np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape == (720, 1280, 3)
    centre = np.round(530.0 * X_CM[:2, 3] / X_CM[2, 3] + [639.5, 359.5]).astype(int)
    around = shown[centre[1] - 60 : centre[1] + 60, centre[0] - 60 : centre[0] + 60].astype(int)
    assert np.any(np.ptp(around, axis=2) > 60)  # coloured lines over a grey picture
