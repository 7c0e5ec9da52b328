"""Faults 28 to 30: what breaks in the plant, judged at its registers and its true spools."""

import numpy as np
import pytest

from plant_emulator.core.faults.kinds import EncoderJump, EncoderStuck, SupplyLost, ValveStuck
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from tests.faults.registers import SHUT
from tests.faults.rig import CLOSING_NS, FaultRig


def test_case_28_an_encoder_stuck_with_its_valve_open_is_found_before_the_joint_has_run_away() -> None:
    """Nobody in the plant knows; to wait for a following error of 4° would cost 9° of slew."""
    rig = FaultRig().moving()
    began_ns, q_before = rig.now_ns, rig.registers.plant.truth().q[0]
    rig.registers.plant.inject(EncoderStuck(joint="slew", reported=False))
    rig.run(1.5)
    rig.assert_safe(FaultCode.ENCODER_STUCK, began_ns, 0.6)
    assert abs(rig.registers.plant.truth().q[0] - q_before) < np.radians(3.0)


def test_case_28_an_encoder_that_the_plant_itself_reports_stops_the_arm_in_the_next_scan() -> None:
    rig = FaultRig().moving()
    began_ns = rig.now_ns
    rig.registers.plant.inject(EncoderStuck(joint="lift"))
    rig.run(1.0)
    rig.assert_safe(FaultCode.PLANT_STATUS, began_ns, 0.011)


@pytest.mark.parametrize("degrees", [2.0, -2.0])
def test_case_29_an_encoder_that_jumps_stops_the_arm_in_the_next_scan(degrees: float) -> None:
    rig = FaultRig().moving()
    began_ns = rig.now_ns
    rig.registers.plant.inject(EncoderJump(joint="lift", angle_mrad=1e3 * np.radians(degrees)))
    rig.run(1.0)
    rig.assert_safe(FaultCode.ENCODER_JUMP, began_ns, 0.011)


def test_case_30_a_stuck_valve_is_named_a_following_error_and_all_others_are_centred() -> None:
    rig = FaultRig().moving()
    rig.registers.plant.inject(ValveStuck(joint="slew"))
    rig.until(lambda: rig.state.group_state is GroupState.ERROR_STOP, 8.0)
    stopped_ns = rig.now_ns
    assert rig.state.fault is FaultCode.FOLLOWING_ERROR
    rig.run(1.0)
    assert not any(row.enables for row in rig.registers.written if row.time_ns > stopped_ns)
    others = [
        np.abs(row.opening[1:]).max() for row in rig.registers.spools if row.time_ns > stopped_ns + CLOSING_NS
    ]
    assert max(others) < SHUT
    assert rig.command(CommandCode.ENABLE) is Reason.ERROR_LATCHED


def test_case_30_a_lost_pump_is_named() -> None:
    rig = FaultRig().moving()
    began_ns = rig.now_ns
    rig.registers.plant.inject(SupplyLost())
    rig.run(1.5)
    rig.assert_safe(FaultCode.SUPPLY_PRESSURE_LOST, began_ns, 0.3)
