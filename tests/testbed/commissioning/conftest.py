"""A world in the excitation mode, one joint alone."""

from collections.abc import Callable

import pytest

from protocol.faults import CommandCode
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.world import World
from testbed.scenarios.scenario import chosen_overrides, load_settings
from tests.support.paths import CONFIGS


@pytest.fixture
def exciting() -> Callable[..., World]:
    """Makes a connected, enabled world in which the valve of ``joint`` is tried out."""

    def made(joint: int = 5, *assignments: str) -> World:
        mode = ["controller.excitation.enabled=true", f"controller.excitation.joints=[{joint}]"]
        settings = load_settings(CONFIGS, chosen_overrides(CONFIGS, None, 1, [*mode, *assignments]))
        world = World(settings, 1, RunLog())
        world.connect()
        run(world.link.command(CommandCode.ENABLE))
        return world

    return made
