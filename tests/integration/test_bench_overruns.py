"""What recording and a live viewer do to the scans of an arm in motion, paired; `make bench`."""

import asyncio
import contextlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from tests.foundation.live.viewing import watching
from tests.integration.services import Running, running, until_healthy
from tests.support.paired import mean_and_half_width

pytestmark = [pytest.mark.bench, pytest.mark.timeout(3600)]

ROUNDS, WINDOW_S = 8, 12.0
BLOCKS, BLOCK_S = 4, 25.0
STROKE_M, STROKE_S = 0.15, 2.0


def late_in_motion(rig: Running, seconds: float) -> tuple[int, int]:
    """Scans that were late, and all, while the arm goes to and fro for so long."""
    cycle = rig.face.get("/state").json()["cycle"]
    until_s, side = time.monotonic() + seconds, 1.0
    while time.monotonic() < until_s:
        asked = {"offset_base_m": [0.0, side * STROKE_M, 0.0], "duration_s": STROKE_S}
        moved = rig.face.post("/operations/move", json=asked, headers={"Prefer": "wait=9"})
        assert moved.status_code in {httpx.codes.OK, httpx.codes.ACCEPTED}, moved.text
        side = -side
    ended = rig.face.get("/state").json()["cycle"]
    return ended["overruns"] - cycle["overruns"], ended["count"] - cycle["count"]


@contextlib.contextmanager
def viewer(rig: Running) -> Iterator[None]:
    """A viewer that asked for every channel, and must have been shown the arm."""
    ended, shown = threading.Event(), []

    async def look_on() -> None:
        assert rig.launch.foxglove is not None
        async with watching(rig.launch.foxglove) as each:
            await each.until(lambda told: {"/plant/truth", "/controller/state"} <= set(told.channels))
            await each.subscribe(*each.channels)
            while not ended.is_set():
                each.shown.clear()
                await each.until(lambda told: len(told.shown) > 20)
                shown.append(len(each.shown))

    thread = threading.Thread(target=lambda: asyncio.run(look_on()))
    thread.start()
    try:
        time.sleep(1.0)
        yield
    finally:
        ended.set()
        thread.join()
    assert shown


def told(what: str, with_it: list[tuple[int, int]], without: list[tuple[int, int]]) -> tuple[float, float]:
    """Print both shares and the paired difference of percent; return it and half its 95 % interval."""
    on, off = ([100.0 * late / scans for late, scans in each] for each in (with_it, without))
    mean, half = mean_and_half_width(np.subtract(on, off).tolist())
    print(f"\nscans late in motion with {what} {np.mean(on):.3f} %, without {np.mean(off):.3f} %, "
          f"difference {mean:+.3f} ± {half:.3f} % (95 %, {len(on)} pairs)")  # fmt: skip
    return mean, half


@contextlib.contextmanager
def enabled(directory: Path, *, recorded: bool = True, foxglove: int | None = None) -> Iterator[Running]:
    with running(directory, recorded=recorded, foxglove=foxglove) as rig:
        until_healthy(rig)
        rig.face.post("/enable").raise_for_status()
        yield rig


def test_a_viewer_makes_no_scan_late(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    taken: dict[bool, list[tuple[int, int]]] = {True: [], False: []}
    with enabled(tmp_path, foxglove=0) as rig:
        for _ in range(ROUNDS):
            for watched in map(bool, rng.permutation(2)):
                with viewer(rig) if watched else contextlib.nullcontext():
                    taken[watched].append(late_in_motion(rig, WINDOW_S))
    mean, half = told("a viewer of every channel", taken[True], taken[False])
    assert mean - half <= 0.0


def test_recording_makes_no_scan_late(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    taken: dict[bool, list[tuple[int, int]]] = {True: [], False: []}
    for number in range(BLOCKS):
        for recorded in map(bool, rng.permutation(2)):
            directory = tmp_path / f"{number}-{recorded}"
            with enabled(directory, recorded=recorded) as rig:
                taken[recorded].append(late_in_motion(rig, BLOCK_S))
            assert bool(list(directory.rglob("*.mcap"))) == recorded
    mean, half = told("recording", taken[True], taken[False])
    assert mean - half <= 0.0
