"""What can break while the plant runs, as data: every kind of fault with its parameters and their ranges.

A fault says *what* is wrong; ``fault_schedule`` says from when to when. Units are in the names, as on every
boundary: the same models are the body of the emulator's HTTP face and the ``fault`` of its recording.
"""

from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from foundation.configuration import StrictModel
from plant_emulator.core.layout import JOINTS, N_ACTUATORS

Joint = Literal["slew", "lift", "tilt", "wrist1", "wrist2", "wrist3"]
Side = Literal["left", "right", "top", "bottom"]
Grey = Annotated[int, Field(ge=0, le=255)]
Share = Annotated[float, Field(gt=0.0, le=1.0)]
LeapMrad = Annotated[float, Field(ge=-1000.0, le=1000.0)]


class BaseFault(StrictModel):
    """What all faults have in common: a kind, and a name that tells two of one kind apart."""

    kind: str

    @property
    def name(self) -> str:
        """Its name in the truth record, such as ``valve_stuck.lift``."""
        return self.kind


class JointFault(BaseFault):
    """A fault of one joint's valve or encoder."""

    joint: Joint

    @property
    def index(self) -> int:
        """The joint's place in every array of six."""
        return JOINTS.index(self.joint)

    @property
    def name(self) -> str:
        """Its name in the truth record, such as ``valve_stuck.lift``."""
        return f"{self.kind}.{self.joint}"


class ValveStuck(JointFault):
    """The spool stays where it is, whatever the command."""

    kind: Literal["valve_stuck"] = "valve_stuck"


class ValveSlow(JointFault):
    """The spool's bandwidth falls to this share of the healthy one: sticky oil, a worn pilot stage."""

    kind: Literal["valve_slow"] = "valve_slow"
    bandwidth_share: Annotated[float, Field(ge=0.01, le=1.0)]


class ValvesWorn(BaseFault):
    """All valves have worn since their numbers were found: edges open later, the hysteresis is wider,
    lowering gets less flow. Shares of what they were.
    """

    kind: Literal["valves_worn"] = "valves_worn"
    deadband_share: Annotated[float, Field(ge=1.0, le=3.0)] = 1.3
    hysteresis_share: Annotated[float, Field(ge=1.0, le=3.0)] = 1.5
    lowering_flow_share: Annotated[float, Field(ge=0.1, le=1.0)] = 0.85


class ValveSwapped(JointFault):
    """The plugs of the valve's two solenoids are swapped: the spool goes the other way."""

    kind: Literal["valve_swapped"] = "valve_swapped"


class SupplyLost(BaseFault):
    """The pump stops and its line is dumped to tank; the status word says so."""

    kind: Literal["supply_lost"] = "supply_lost"


class EncoderStuck(JointFault):
    """The count stays where it is. ``reported``: the status word's sensor bit says so."""

    kind: Literal["encoder_stuck"] = "encoder_stuck"
    reported: bool = True


class EncoderJump(JointFault):
    """The count leaps by this angle at once and stays off by it: a slipped coupling, lost turns."""

    kind: Literal["encoder_jump"] = "encoder_jump"
    angle_mrad: LeapMrad


class EncoderBias(JointFault):
    """The count creeps off by this angle over ``ramp_s``, too slowly for a watch on leaps to notice."""

    kind: Literal["encoder_bias"] = "encoder_bias"
    angle_mrad: LeapMrad
    ramp_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 2.0


class PayloadDrop(BaseFault):
    """The load falls off the tool; its end puts it back."""

    kind: Literal["payload_drop"] = "payload_drop"


class PayloadChange(BaseFault):
    """The load becomes this mass at once; its end restores the former one."""

    kind: Literal["payload_change"] = "payload_change"
    mass_kg: Annotated[float, Field(ge=0.0, le=1000.0)]


class ObjectMoves(BaseFault):
    """The object, with the markers and plates that hang about it, slides along one of its own axes; the wall
    stays. A hanging plate, the other machine's soft ground, a boat. Its end puts it back.
    """

    kind: Literal["object_moves"] = "object_moves"
    speed_mm_s: Annotated[float, Field(ge=-100.0, le=100.0)]
    axis: Literal["x", "y", "z"] = "x"


class CameraFrozen(BaseFault):
    """The same picture again and again: the last one taken before the fault.

    ``stamps`` ``advance``: under new frame numbers and capture times, as a driver does that stamps a stale
    buffer; only the content betrays it. ``hold``: under the old ones, so that age betrays it too.
    """

    kind: Literal["camera_frozen"] = "camera_frozen"
    stamps: Literal["advance", "hold"] = "advance"


class CameraBlind(BaseFault):
    """Both eyes see one even grey level and their noise: 0 a cap on the lens, 255 the sun in it."""

    kind: Literal["camera_blind"] = "camera_blind"
    grey: Grey = 0


class FramesDropped(BaseFault):
    """This share of the frames never arrives, drawn by seed and frame number."""

    kind: Literal["frames_dropped"] = "frames_dropped"
    share: Share = 1.0


class MarkerCovered(BaseFault):
    """A plain sheet lies over this share of a marker's plate, from one side on: dirt, a rag, a hose."""

    kind: Literal["marker_covered"] = "marker_covered"
    marker_id: Annotated[int, Field(ge=0, lt=1000)]
    share: Share = 0.5
    side: Side = "left"
    grey: Grey = 60

    @property
    def name(self) -> str:
        """Its name in the truth record, such as ``marker_covered.3``."""
        return f"{self.kind}.{self.marker_id}"


class CouplerSilent(BaseFault):
    """The fieldbus face answers nothing and carries out nothing; its connections stay open."""

    kind: Literal["coupler_silent"] = "coupler_silent"


class OwnFault(BaseFault):
    """Base of a disturbance of your own: what it does, as pure methods, neutral as they stand here.

    ``elapsed_s`` is the simulated time since it began. Encoders are asked at every reading; valves, pump and
    load when it begins, and again every ``every_s`` of simulated time, if that is not 0.
    """

    every_s: ClassVar[float] = 0.0

    def encoder_shift(self, elapsed_s: float) -> NDArray[np.float64]:
        """How far (6,), rad, the encoders' readings are off, base first."""
        return np.zeros(N_ACTUATORS)

    def valve_speed(self, elapsed_s: float) -> NDArray[np.float64]:
        """Share (6,), 0 to 1, that is left of the bandwidth of each spool; 0: it stays where it is."""
        return np.ones(N_ACTUATORS)

    def pump_runs(self, elapsed_s: float) -> bool:
        """Whether the pump runs."""
        return True

    def load_kg(self, elapsed_s: float, load_kg: float) -> float:
        """The load at the tool (kg, 0 to 1000) in place of ``load_kg``."""
        return load_kg


Fault = (
    ValveStuck
    | ValveSlow
    | ValvesWorn
    | ValveSwapped
    | SupplyLost
    | EncoderStuck
    | EncoderJump
    | EncoderBias
    | PayloadDrop
    | PayloadChange
    | ObjectMoves
    | CameraFrozen
    | CameraBlind
    | FramesDropped
    | MarkerCovered
    | CouplerSilent
)
AnyFault = Fault | OwnFault
FAULTS: dict[str, type[BaseFault]] = {kind.model_fields["kind"].default: kind for kind in get_args(Fault)}
