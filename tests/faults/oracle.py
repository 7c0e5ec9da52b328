"""What the axes group must answer and where it must then stand, written from the page's clauses 7.1 to 7.6.

It imports the enumerations and nothing of the controller: six facts, and a few sentences about them.
"""

from dataclasses import dataclass
from enum import Enum

from protocol.faults import CommandCode, FaultCode, GroupState, Reason


class Doing(Enum):
    """What an enabled group is at; OFF: the valves are not driven."""

    OFF = "off"
    HOLDING = "holding"
    MOVING = "moving"
    STREAMING = "streaming"
    STOPPING = "stopping"
    DISABLING = "disabling"
    FAILING = "failing"  # ramps down on a fault


_RAMPS = (Doing.MOVING, Doing.STOPPING)  # a stream to which no reference came stands still already


@dataclass
class Oracle:
    """``fault``: the first since the last reset. ``emergency``: latched. ``attended``: the stream is."""

    doing: Doing = Doing.OFF
    fault: FaultCode = FaultCode.NONE
    emergency: bool = False
    attended: bool = True

    @property
    def group(self) -> GroupState:
        """What STATE must show."""
        if self.fault is not FaultCode.NONE:
            return GroupState.ERROR_STOP
        return {
            Doing.OFF: GroupState.DISABLED,
            Doing.HOLDING: GroupState.STANDBY,
            Doing.MOVING: GroupState.MOVING,
            Doing.STREAMING: GroupState.MOVING,
            Doing.STOPPING: GroupState.STOPPING,
            Doing.DISABLING: GroupState.STOPPING,
        }[self.doing]

    @property
    def live(self) -> bool:
        """Whether the enable must be given."""
        return self.doing is not Doing.OFF

    def command(self, code: CommandCode, *, plant: bool, link: bool) -> Reason:
        """The reason that must answer ``code`` while plant and reference link are heard, or not."""
        return getattr(self, f"_{code.name.lower()}")(plant, link)  # type: ignore[no-any-return]

    def reference(self, *, link: bool) -> Reason:
        """The reason that must answer a sound reference."""
        refusal = self._no_motion()
        if refusal is not None:
            return refusal
        if self.doing is Doing.STREAMING:
            return Reason.STREAMING
        if not link:
            return Reason.REFERENCE_LINK_DOWN
        self.doing = Doing.MOVING
        return Reason.ACCEPTED

    def rested(self) -> None:
        """What was under way has come to rest."""
        after = {
            Doing.MOVING: Doing.HOLDING,
            Doing.STOPPING: Doing.HOLDING,
            Doing.DISABLING: Doing.OFF,
            Doing.FAILING: Doing.OFF,
        }
        self.doing = after.get(self.doing, self.doing)

    def link_fell_silent(self) -> None:
        """The reference link is dead in this scan."""
        if self.doing is Doing.MOVING:
            self.doing = Doing.FAILING
            self._fails(FaultCode.REFERENCE_LINK_LOST)
        elif self.doing is Doing.HOLDING:
            self.doing = Doing.OFF
        elif self.doing is Doing.STOPPING:
            self.doing = Doing.DISABLING
        self.attended = False

    def broke(self, fault: FaultCode) -> None:
        """A fault that cannot wait for a ramp; it concerns a group whose valves are driven."""
        if self.live:
            self.doing = Doing.OFF
            self._fails(fault)

    def _fails(self, fault: FaultCode) -> None:
        if self.fault is FaultCode.NONE:
            self.fault = fault

    def _no_motion(self) -> Reason | None:
        """Why no motion at all can begin."""
        if self.emergency:
            return Reason.EMERGENCY_LATCHED
        if self.fault is not FaultCode.NONE:
            return Reason.ERROR_LATCHED
        if self.doing is Doing.OFF:
            return Reason.DISABLED
        return Reason.STOPPING if self.doing in (Doing.STOPPING, Doing.DISABLING) else None

    def _enable(self, plant: bool, link: bool) -> Reason:
        if self.emergency:
            return Reason.EMERGENCY_LATCHED
        if self.fault is not FaultCode.NONE:
            return Reason.ERROR_LATCHED
        if self.doing is Doing.DISABLING:
            return Reason.STOPPING
        if self.live:
            return Reason.ALREADY_DONE
        if not plant:
            return Reason.PLANT_LINK_DOWN
        if not link:
            return Reason.REFERENCE_LINK_DOWN
        self.doing = Doing.HOLDING
        return Reason.ACCEPTED

    def _disable(self, _plant: bool, _link: bool) -> Reason:
        if self.doing is Doing.FAILING:
            return Reason.ERROR_LATCHED
        if self.doing in (Doing.OFF, Doing.DISABLING):
            return Reason.ALREADY_DONE
        self.doing = Doing.DISABLING if self.doing in _RAMPS else Doing.OFF
        return Reason.ACCEPTED

    def _stop(self, _plant: bool, _link: bool) -> Reason:
        if self.doing is Doing.MOVING:
            self.doing = Doing.STOPPING
        elif self.doing is Doing.STREAMING:
            self.doing = Doing.HOLDING
        return Reason.ACCEPTED

    def _reset(self, plant: bool, link: bool) -> Reason:
        if self.emergency:
            return Reason.EMERGENCY_LATCHED
        if self.fault is FaultCode.NONE:
            return Reason.NOT_IN_ERROR
        if self.doing is Doing.FAILING:
            return Reason.STOPPING
        if not plant:
            return Reason.PLANT_LINK_DOWN
        if not link:
            return Reason.REFERENCE_LINK_DOWN
        self.fault = FaultCode.NONE
        return Reason.ACCEPTED

    def _emergency_stop(self, _plant: bool, _link: bool) -> Reason:
        if self.emergency:
            return Reason.ALREADY_DONE
        self.doing, self.emergency = Doing.OFF, True
        self._fails(FaultCode.EMERGENCY_STOP)
        return Reason.ACCEPTED

    def _emergency_release(self, _plant: bool, _link: bool) -> Reason:
        known, self.emergency = self.emergency, False
        return Reason.ACCEPTED if known else Reason.ALREADY_DONE

    def _start_stream(self, _plant: bool, link: bool) -> Reason:
        refusal = self._no_motion()
        if refusal is not None:
            return refusal
        if self.doing is Doing.MOVING:
            return Reason.MOVING
        if self.doing is Doing.STREAMING:
            return Reason.STREAMING
        if not link:
            return Reason.REFERENCE_LINK_DOWN
        self.doing, self.attended = Doing.STREAMING, True
        return Reason.ACCEPTED

    def _end_stream(self, _plant: bool, _link: bool) -> Reason:
        if self.doing is not Doing.STREAMING or not self.attended:
            return Reason.NOT_STREAMING
        self.doing = Doing.HOLDING  # no reference came: there is nothing to go on to
        return Reason.ACCEPTED
