"""The table of programs: bodies keep to the settings, and needs refuse by the program's own name."""

from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import Field, ValidationError

from foundation.configuration import StrictModel
from protocol.errors import ConfigurationError, LinkLost, RequestRefused
from protocol.faults import FaultCode, GroupState
from tests.vision_pc.program_settings import BOOM, shipped
from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import body_of
from vision_pc.application.ports import CameraStatus
from vision_pc.application.program import Program, by_name
from vision_pc.application.programs import PROGRAMS

BY_NAME = {program.name: program for program in PROGRAMS}


class Settings(StrictModel):
    """Settings of a program that does not exist."""

    near_m: float = Field(0.02, gt=0.001, le=0.05)
    turns: int = Field(3, ge=1, le=9)


Body: Any = body_of(Settings, "near_mm", "turns")


def application(state: GroupState = GroupState.STANDBY, *, camera: bool = True, log: bool = True) -> Any:
    """An application of which only the state matters."""
    told = SimpleNamespace(group_state=state, flags=0, fault=FaultCode.NONE)
    controller = SimpleNamespace(state=told, connected=True)
    status = SimpleNamespace(status=lambda: CameraStatus(camera, 0.0, 1, 10.0))
    unused: Any = None
    return VisionApplication(
        unused,
        unused,
        controller,
        status,
        shipped(),
        BOOM,
        SimpleNamespace(healthy=log),  # type: ignore[arg-type]
    )


def test_a_body_lays_what_is_given_over_the_settings_in_their_unit() -> None:
    assert Body().overrides() == {}
    assert Body(near_mm=10.0).overrides() == {"near_m": 0.01}
    row: Any = Program("a", "A", None, dict, Body, lambda _: Settings())  # type: ignore[arg-type]
    assert row.requested(application(), Body(turns=4)) == Settings(turns=4)


@pytest.mark.parametrize(
    "given",
    [{"near_m": 0.01}, {"near_mm": 1.0}, {"near_mm": 50.1}, {"turns": 10}, {"turns": 1.5}, {"turns": "3"}],
)
def test_a_body_is_as_strict_as_the_settings_and_within_their_limits(given: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Body(**given)


def test_what_is_in_range_alone_may_be_refused_together() -> None:
    """The settings have the last word: a body is never looser than they are."""

    class Paired(Settings):
        turns: int = Field(3, ge=1, le=2)

    row: Any = Program("a", "A", None, dict, Body, lambda _: Paired())  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match="turns = 5"):
        row.requested(application(), Body(turns=5))


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_a_moving_arm_refuses_every_program_by_its_own_name(program: Program[Any, Any]) -> None:
    with pytest.raises(RequestRefused, match=f"^{program.name}: the arm is moving") as refused:
        program.refuse_now(application(GroupState.MOVING), _asked(program))
    assert refused.value.cause == "refused.moving"


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_what_moves_the_arm_needs_it_enabled_and_a_log_and_what_looks_a_camera(
    program: Program[Any, Any],
) -> None:
    standing = {"look", "hand-eye-start", "hand-eye-sample", "hand-eye-solve"}
    asked = _asked(program)
    for broken, cause in (
        (application(GroupState.DISABLED), "refused.disabled"),
        (application(GroupState.STOPPING), "refused.stopping"),
        (application(GroupState.ERROR_STOP), "refused.error_latched"),
        (application(log=False), "refused.recording_failed"),
    ):
        if program.name in standing:
            program.refuse_now(broken, asked)
        else:
            with pytest.raises(RequestRefused, match=f"^{program.name}: ") as refused:
                program.refuse_now(broken, asked)
            assert refused.value.cause == cause
    if program.name in ("move", "home"):
        program.refuse_now(application(camera=False), asked)
    else:
        with pytest.raises(LinkLost) as lost:
            program.refuse_now(application(camera=False), asked)
        assert lost.value.cause == "link.camera_silent"


@pytest.mark.parametrize(
    ("name", "body", "track", "calibration", "met"),
    [
        ("look-then-move", {}, False, False, False),
        ("look-then-move", {}, True, False, True),
        ("look-then-move", {}, False, True, False),
        ("look-then-move", {"method": "paper"}, False, True, True),
        ("look-then-move", {"method": "paper"}, True, False, False),
        ("looking-and-moving", {}, False, False, False),
        ("looking-and-moving", {}, True, False, True),
        ("looking-and-moving", {}, False, True, True),
    ],
)
def test_what_was_calibrated_decides_what_may_begin(
    name: str, body: dict[str, Any], track: bool, calibration: bool, met: bool
) -> None:
    rig = application()
    rig.track, rig.calibration = track or None, calibration or None
    program = BY_NAME[name]
    asked = program.requested(rig, program.body(**body))
    if met:
        program.refuse_now(rig, asked)
    else:
        with pytest.raises(RequestRefused) as refused:
            program.refuse_now(rig, asked)
        assert refused.value.cause == "refused.not_calibrated"


def test_a_name_is_taken_once() -> None:
    with pytest.raises(ConfigurationError, match="named move") as refused:
        by_name([*PROGRAMS, BY_NAME["move"]])
    assert refused.value.cause == "configuration.program_twice"


def _asked(program: Program[Any, Any]) -> Any:
    """Settings of a request where the program has any, as configured."""
    if program.name.startswith("hand-eye") or program.settings is None:
        return None
    return program.requested(application(), program.body())


async def test_nothing_begins_without_a_controller() -> None:
    class Absent:
        connected = False

        @property
        def state(self) -> Any:
            raise LinkLost("link.not_connected", "no controller")

    bare: Any = application()
    bare.controller = Absent()
    for program in PROGRAMS:
        with pytest.raises(LinkLost, match="no controller"):
            program.refuse_now(bare, None)
