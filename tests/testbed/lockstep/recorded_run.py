"""A short run in lockstep, recorded by all three parts."""

from contextlib import ExitStack, closing
from pathlib import Path
from typing import NamedTuple

from protocol.reference_messages import ReferencePose
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.rig import CONTROLLER, TRUTH, VISION, LockstepRig
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS
from vision_pc.core.types import Look

CONTROLLER_FILE = CONTROLLER / "controller.mcap"
FILES = (TRUTH, CONTROLLER_FILE, VISION)


class RecordedRun(NamedTuple):
    """Where the recordings are, the looks that were taken, and the run's digest."""

    directory: Path
    looks: list[Look]
    digest: str


def recorded_run(directory: Path | None, images: str = "none", seed: int = 1) -> RecordedRun:
    """Two looks, some watched frames between them, and a reference; unrecorded without ``directory``."""
    settings = load_settings(CONFIGS, {"vision": {"recording": {"images": images}}})
    rig = LockstepRig(settings, seed, RunLog())
    with ExitStack() as stack:
        if directory is not None:
            stack.enter_context(closing(rig.record_in(directory, "session 7")))
        rig.command("enable")
        looks = [run(rig.application.eyes.look(2))]
        run(_watched(rig))
        looks.append(run(rig.application.eyes.look(1)))
        here = rig.world.states[-1].X_BT
        run(rig.link.request(ReferencePose(0, here, 1.0)))
    return RecordedRun(directory or Path(), looks, rig.world.log.digest())


async def _watched(rig: LockstepRig) -> None:
    """Some frames, with markers and odometry."""
    async with rig.application.eyes.watch(markers=True, odometry=True) as watch:
        await watch.after(2, 5.0)
