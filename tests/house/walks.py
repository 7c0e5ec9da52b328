"""How often who follows one thing through the house changes the file: ``python -m tests.house.walks``.

A walk reads every function when it is first called, and goes on in the caller when that calls the next one.
*Stays* are the files read one after the other, *returns* those of them that were read before. A file whose
functions call no other file is looked up and not counted.
"""

import asyncio
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

from protocol.reference_messages import ReferencePose
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.reporting.console import bars
from testbed.scenarios.scenario import chosen_overrides, load_settings
from tests.house.measures import ROOT
from tests.support.paths import CONFIGS
from tests.vision_pc.synthetic_station import bench


class Walk(NamedTuple):
    """From the call of a function (``MODULE.NAME``) to that of another; to its end if that is the same."""

    what: str
    begins: str
    ends: str


LOOK = Walk("frame to look", "vision_pc.core.pixel_sensor.observe", "vision_pc.core.pixel_sensor.observe")
SCAN = Walk("inputs to valve word", "controller.core.scan_program.scan", "controller.core.scan_program.scan")
STEP = Walk(
    "track to reference",
    "vision_pc.core.calibration.local_error_model.fit_error_model",
    "vision_pc.application.reference_link.request",
)
ANSWER = Walk(
    "request to answer",
    "vision_pc.shell.rest.operation_routes.start",
    "vision_pc.shell.rest.operation_routes.start",
)


class Walker:
    """A profiler that notes the calls between files that a walk makes, however often it is made."""

    def __init__(self, walk: Walk) -> None:
        self._walk = walk
        self._walking = False
        self._read: set[Any] = set()
        self._calls: list[tuple[str, str]] = []

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        if event not in ("call", "return") or (name := _place(frame)) is None:
            return
        function = f"{name}.{frame.f_code.co_name}"
        if event == "call":
            self._walking |= function == self._walk.begins
            if self._walking and frame.f_code not in self._read:
                self._read.add(frame.f_code)
                self._calls.append((next(_callers(frame), name), name))
        if function == self._walk.ends and (event == "return" or self._walk.begins != self._walk.ends):
            self._walking = False

    @property
    def stays(self) -> list[str]:
        """The files in the order in which they are read."""
        calling = {caller for caller, callee in self._calls if caller != callee}
        stays: list[str] = []
        for place in (place for call in self._calls for place in call):
            if place in calling and stays[-1:] != [place]:
                stays.append(place)
        return stays


_APART = (".", "tests", "testbed", "laboratory", "plant_emulator")


def _callers(frame: FrameType) -> Iterator[str]:
    above = frame.f_back
    while above is not None:
        if (place := _place(above)) is not None:
            yield place
        above = above.f_back


def _place(frame: FrameType) -> str | None:
    """The module of a frame of the house; not of tests, nor of the world, which draws what is looked at."""
    path = Path(frame.f_code.co_filename)
    if not path.is_relative_to(ROOT):
        return None
    parts = path.relative_to(ROOT).with_suffix("").parts
    return None if parts[0].startswith(_APART) else ".".join(parts)


def walks() -> list[tuple[str, list[str]]]:
    """The stays of each walk: a look and a motion in lockstep, two operations by REST of a synthetic arm."""
    rig = LockstepRig(load_settings(CONFIGS, chosen_overrides(CONFIGS, "standard", 1, [])), 1, RunLog())
    rig.command("enable")
    with bars(quiet=True) as shown, shown.step("look") as bar:
        look = _walked(LOOK, lambda: rig.operate("look", {"frames": 2}, bar))
    here = rig.world.states[-1].X_BT
    x, y, z = here.p_m
    rig.link.submit(ReferencePose(0, here._replace(p_m=(x, y + 0.1, z)), 0.0))
    scan = _walked(SCAN, lambda: [rig.world.clock.advance() for _ in range(60)])
    return [
        look,
        _walked(STEP, lambda: asyncio.run(_asked())),
        scan,
        _walked(ANSWER, lambda: asyncio.run(_asked())),
    ]


def _walked(walk: Walk, work: Callable[[], object]) -> tuple[str, list[str]]:
    walker = Walker(walk)
    sys.setprofile(walker)
    try:
        work()
    finally:
        sys.setprofile(None)
    return walk.what, walker.stays


async def _asked() -> None:
    async with bench() as station:
        await station.post("/enable")
        for kind in ("look", "local-track", "look-then-move"):
            await station.succeeded(kind)


if __name__ == "__main__":
    for what, stays in walks():
        most = Counter(stays).most_common(3)
        often = ", ".join(f"{place.rsplit('.', 1)[-1]} {count} times" for place, count in most)
        print(f"{what}: {len(stays)} stays, {len(stays) - len(set(stays))} returns; {often}")
