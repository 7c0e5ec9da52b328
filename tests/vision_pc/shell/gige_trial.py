"""Two GigE cameras of Aravis' own and the source that reads them, in a network namespace: prints what came.

``python -m tests.vision_pc.shell.gige_trial KEY=VALUE…`` (of vision); 127.0.0.2 is to be an address there.
"""

import asyncio
import json
import sys
import time
from collections.abc import Callable

from foundation.configuration import load, parse_overrides
from tests.support.fake_gige import FakeGigeCamera
from tests.support.paths import CONFIGS
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.cameras import open_camera

PERIOD_NS = 50_000_000
OURS = (
    "vision.camera.source=genicam", "vision.camera.genicam.left=127.0.0.1", "vision.camera.width_px=320",
    "vision.camera.genicam.right=127.0.0.2", "vision.camera.height_px=240", "vision.camera.stale_ms=1000",
)  # fmt: skip


class Eye:
    """Shows the moment's number as grey; both eyes show the same moments."""

    def __init__(self, address: str, base: int) -> None:
        self._base, self._shown = base, 0
        self.camera = FakeGigeCamera(address, f"T{base}", self.fill)

    def fill(self, width: int, height: int) -> tuple[bytes, int]:
        moment = max(time.time_ns() // PERIOD_NS, self._shown + 1)
        time.sleep(max(moment * PERIOD_NS - time.time_ns(), 0) / 1e9)
        self._shown = moment
        return bytes([self._base + moment % 100]) * (width * height), moment * PERIOD_NS


async def _until(happened: Callable[[], bool], deadline_s: float) -> None:
    while not happened() and time.monotonic() < deadline_s:  # noqa: ASYNC110 - another thread makes it so
        await asyncio.sleep(0.1)


async def main(overrides: list[str]) -> None:
    """Two seconds of pairs, an unplugged eye, and its return."""
    eyes = [Eye("127.0.0.1", 0), Eye("127.0.0.2", 100)]
    last = {each.partition("=")[0]: each for each in (*OURS, *overrides)}
    document = parse_overrides(list(last.values()))["vision"]
    source = open_camera(load(VisionConfig, CONFIGS / "vision.yaml", document).camera)
    await source.start()
    pairs, reports = [], []
    ends = time.monotonic() + 4.0
    try:
        async for pair in source.pairs():
            pairs.append((int(pair.left[0, 0]), int(pair.right[0, 0]), time.monotonic_ns() - pair.capture_ns))
            if time.monotonic() > ends:
                break
    except Exception as error:
        reports.append(f"{getattr(error, 'cause', '')}: {error}")
    if pairs:
        eyes[1].camera.close()
        before = source.status().frames
        await _until(lambda: source.status().trouble is not None, ends + 20.0)
        reports.append(source.status().trouble)
        eyes[1] = Eye("127.0.0.2", 100)
        await _until(lambda: source.status().frames > before + 3, ends + 40.0)
        reports.append(source.status().frames > before + 3)
    status = source.status()
    await source.close()
    print(
        json.dumps({"pairs": pairs, "reports": reports, "dropped": status.dropped, "detail": status.detail})
    )


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1:]))
