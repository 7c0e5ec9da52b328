"""The constants of the text: those of the configuration, and what the program has no part for is refused."""

import pytest

from controller.config import ControllerConfig
from controller_st.constants import constants_text, refuse_edited
from controller_st.program import texts
from foundation.configuration import load, parse_overrides
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError
from structured_text.program import CompiledProgram
from tests.structured_text.c_layout import check_offsets
from tests.support.paths import CONFIGS
from tools.pages import PLC_CONSTANTS, plc_constants


def configured(*overrides: str) -> tuple[NominalArm, ControllerConfig]:
    given = parse_overrides(overrides)
    return (
        load(NominalArm, CONFIGS / "arm.yaml", given.get("arm")),
        load(ControllerConfig, CONFIGS / "controller.yaml", given.get("controller")),
    )


def test_the_committed_constants_are_those_of_the_shipped_configuration() -> None:
    assert PLC_CONSTANTS.read_text(encoding="utf-8") == plc_constants(), "run: python -m tools.pages"


@pytest.mark.slow("a program is compiled")
def test_a_changed_gain_and_limit_reach_the_program() -> None:
    changed = CompiledProgram(
        texts(*configured("controller.supervision.overspeed_m_s=0.5", "controller.cycle_ms=2"))
    )
    assert (changed.constant("LR_WATCH_OVERSPEED"), changed.constant("LR_CYCLE_NS")) == (0.5, 2_000_000)


@pytest.mark.parametrize(
    "override",
    [
        "controller.parking.enabled=true",
        "controller.excitation.enabled=true",
        "controller.reference_link.link_key.environment=KEY",
        "controller.valves.pressure_compensated=true",
        "controller.valves.lift.hysteresis.value=0.01",
    ],
)
def test_what_the_program_has_no_part_for_is_refused_by_its_key(override: str) -> None:
    with pytest.raises(ConfigurationError, match="structured text has no such part") as caught:
        constants_text(*configured(override))
    assert caught.value.cause == "controller_st.left_out"


@pytest.mark.slow("a program is compiled")
def test_every_type_of_the_program_lies_as_ctypes_lays_it_out() -> None:
    program = CompiledProgram(texts(*configured()))
    assert sum(check_offsets(of) for of in program.types.values()) > 500


def test_constants_that_were_edited_are_refused_and_not_ignored() -> None:
    shipped = PLC_CONSTANTS.read_text(encoding="utf-8")
    refuse_edited(shipped)
    for edited in (shipped.replace("5.0", "6.0", 1), shipped[: shipped.rindex("(*")], shipped + "\n"):
        with pytest.raises(ConfigurationError, match=r"was edited.*--set") as caught:
            refuse_edited(edited)
        assert caught.value.cause == "controller_st.edited_constants"
