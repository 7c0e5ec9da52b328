"""What can break while the plant runs, as data."""

from enum import Enum
from typing import NamedTuple

from plant_emulator.core.layout import JOINTS
from protocol.errors import RequestRefused


class FaultKind(Enum):
    """The plant's own faults; ``value`` of a Fault means what is said here."""

    VALVE_STUCK = "valve_stuck"  # the spool stays where it is
    VALVE_SLOW = "valve_slow"  # the spool's bandwidth falls to this fraction, 0.01 to 1
    SUPPLY_LOST = "supply_lost"  # the pump stops and its line is dumped to tank
    ENCODER_STUCK = "encoder_stuck"  # the count stays where it is
    ENCODER_BIAS = "encoder_bias"  # this angle (rad) is added: a jump when set at once


class Fault(NamedTuple):
    """One fault: its kind, the joint it concerns (none for the supply) and its size where it has one."""

    kind: FaultKind
    joint: int = -1
    value: float = 0.0

    def name(self) -> str:
        """Its name in the truth record, such as ``valve_stuck.lift``."""
        return self.kind.value if self.joint < 0 else f"{self.kind.value}.{JOINTS[self.joint]}"


def checked(fault: Fault) -> Fault:
    """``fault`` itself. Raises RequestRefused when it names no joint of this arm or a size out of range."""
    concerns_joint = fault.kind is not FaultKind.SUPPLY_LOST
    if concerns_joint != (0 <= fault.joint < len(JOINTS)):
        wanted = f"0 to {len(JOINTS) - 1}" if concerns_joint else "none"
        raise RequestRefused("refused.fault_joint", f"{fault.kind.value}: joint {fault.joint}, want {wanted}")
    if fault.kind is FaultKind.VALVE_SLOW and not 0.01 <= fault.value <= 1.0:
        raise RequestRefused("refused.fault_value", f"valve_slow: fraction {fault.value:g}, wanted 0.01 to 1")
    if fault.kind is FaultKind.ENCODER_BIAS and not abs(fault.value) <= 1.0:
        raise RequestRefused("refused.fault_value", f"encoder_bias: {fault.value:g} rad, wanted -1 to 1")
    return fault
