"""ORB-SLAM3 in place of Longreach's odometry: it reads the camera's stream and tells poses by UDP.

Beside it: longreach up --set vision.odometry_feed.source=udp. Needs pyorbslam3 (GPL-3, `make peers`). Any
program that sends `t x y z qx qy qz qw`, t the picture's Unix time, can stand here. Ctrl-C ends it.
"""

import asyncio
import socket
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path

from orb_slam3 import OrbSlam3, vocabulary
from scipy.spatial.transform import Rotation

from foundation.configuration import load, parse_overrides
from protocol.errors import LinkLost
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.types import StereoPair
from vision_pc.shell.cameras import CameraSource, open_camera

CONFIGS = Path(__file__).parents[2] / "configs"
PICTURES = 12  # that its vocabulary is grown from


async def pairs_of(camera: CameraSource) -> AsyncIterator[StereoPair]:
    """The camera's pairs, on and on: a stream that stops on a busy machine comes again."""
    while True:
        try:
            async for pair in camera.pairs():
                yield pair
        except LinkLost as error:
            print(f"{error.cause}: {error}", file=sys.stderr, flush=True)
            await asyncio.sleep(1.0)


async def main(overrides: list[str]) -> None:
    """``overrides``: settings of vision, such as vision.camera.stream.port=47100."""
    config = load(VisionConfig, CONFIGS / "vision.yaml", parse_overrides(overrides).get("vision"))
    feed = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    camera = open_camera(config.camera)
    await camera.start()
    while camera.newest is None:  # noqa: ASYNC110 - a thread of its own connects
        await asyncio.sleep(0.1)
    with tempfile.TemporaryDirectory() as directory:
        words, pictures = Path(directory) / "words.txt", []
        async for pair in pairs_of(camera):
            pictures += [pair.left, pair.right]
            if len(pictures) >= 2 * PICTURES:
                break
        vocabulary(pictures, words)
        slam, sent = OrbSlam3(calibration(config.camera), words), 0
        async for pair in pairs_of(camera):
            since_1970_ns = time.time_ns() - time.monotonic_ns()
            unix_s = 1e-9 * (pair.capture_ns + since_1970_ns)
            pose = slam.track(pair, unix_s)
            if pose is None:
                continue
            numbers = *pose.X_C0C[:3, 3], *Rotation.from_matrix(pose.X_C0C[:3, :3]).as_quat()
            line = f"{unix_s:.6f} " + " ".join(f"{number:.9g}" for number in numbers)
            feed.sendto(line.encode(), (config.odometry_feed.host, config.odometry_feed.port))
            sent += 1
            if sent == 1:
                print("poses are sent", flush=True)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1:]))
