"""A controller that drives another arm than vision's arm.yaml says: refused at HELLO, told, at rest."""

from tests.faults.live import LiveRig, Machine, live
from tests.vision_pc.shell.loopback_controller import until
from vision_pc.shell.rest.state_view import link_view


def another_arm() -> Machine:
    """A controller whose arm.yaml has another least radius of its workspace: enough to be another arm."""
    return Machine("arm.workspace.radius_min_m=1.1")


async def test_a_controller_of_another_arm_is_refused_with_its_cause_and_nothing_moves() -> None:
    async with live(machine=another_arm()) as rig:
        await until(lambda: _cause(rig) == "link.wrong_arm", 5.0)
        for path in ("/state", "/health", "/link"):
            answer = await rig.client.get(path)
            text = answer.text
            assert "link.wrong_arm" in text, path
            assert "another arm than arm.yaml" in text, path
        assert (await rig.client.get("/link")).json()["connected"] is False
        for command in ("/enable", "/operations/move"):
            body = {"offset_tool_m": [0.05, 0.0, 0.0]} if command.endswith("move") else None
            refused = await rig.post(command, body)
            assert refused.status_code == 503
            assert refused.json()["cause"] == "link.wrong_arm"
        assert rig.machine.motions == set()
        assert rig.machine.at_rest()


def _cause(rig: LiveRig) -> str:
    trouble = link_view(rig.station.controller).trouble
    return trouble.cause if trouble else ""


async def test_any_arm_is_an_explicit_setting_and_is_accepted() -> None:
    async with live(machine=another_arm(), any_arm=True) as rig:
        assert (await rig.client.get("/link")).json()["trouble"] is None
        started = await rig.post("/operations/move", {"offset_tool_m": [0.02, 0.0, 0.0]})
        assert started.status_code == 202
        await until(lambda: rig.machine.motions, 10.0)
