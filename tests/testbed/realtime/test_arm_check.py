"""`longreach doctor` prints the arm's hash and asks a controller that is there whether it has the same."""

import asyncio

from foundation.configuration import configuration_hash
from testbed.realtime.doctor import HealthCheck, arm_check
from testbed.realtime.launch import free_port
from tests.faults.live import Machine
from tests.faults.rig import settings_of
from vision_pc.config.vision import LinkSettings

ARM = settings_of(1, ()).arm


async def checked(machine: Machine, **link: bool) -> HealthCheck:
    await machine.start()
    try:
        return await asyncio.to_thread(arm_check, ARM, LinkSettings(port=machine.port, **link))
    finally:
        await machine.stop()


def test_without_a_controller_the_hash_is_printed_for_a_plc() -> None:
    check = arm_check(ARM, LinkSettings(port=free_port()))
    assert check.verdict == "ok"
    assert f"{configuration_hash(ARM):#018x}" in check.found
    assert "no controller" in check.found


async def test_a_controller_of_the_same_arm_is_fine_and_its_session_is_given_back() -> None:
    machine = Machine()
    for _ in range(2):  # a session left open would occupy it
        check = await checked(machine)
        assert check.verdict == "ok"
        assert "has the same" in check.found


async def test_a_controller_of_another_arm_fails_unless_any_arm_will_do() -> None:
    check = await checked(Machine("arm.workspace.radius_min_m=1.1"))
    assert check.verdict == "failed"
    assert "has another" in check.found
    assert "any_arm" in check.advice
    assert (await checked(Machine("arm.workspace.radius_min_m=1.1"), any_arm=True)).verdict == "warning"
