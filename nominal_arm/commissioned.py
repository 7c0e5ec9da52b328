"""What commissioned.yaml may say: numbers found on one machine, each with its spread, and what they rest on.

Commissioning writes the file; the controller reads it. Nothing here knows how a number is found.
"""

from collections.abc import Iterator
from typing import Annotated, NamedTuple, Self

from pydantic import AfterValidator, BaseModel, Field, model_validator

from foundation.configuration import StrictModel, configuration_hash
from nominal_arm.description import JOINT_NAMES, NominalArm
from protocol.errors import ConfigurationError

_NEAR_BOUND = 1e-3  # of the way between its bounds: there a fit was stopped, not finished
CURVE_KNOTS = 8

Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


class MeasuredNumber(StrictModel):
    """One number with its standard deviation.

    ``bounds``: between what it was sought, null where nothing bounds it. ``recording``: what it came from.
    """

    value: float
    std: float = Field(ge=0.0)
    bounds: tuple[float | None, float | None] = (None, None)
    recording: str = ""

    def bound_reached(self) -> float | None:
        """The bound at which the number sits, None when it lies between its bounds."""
        lower, upper = self.bounds
        near = _NEAR_BOUND * abs(upper - lower) if lower is not None and upper is not None else 0.0
        if lower is not None and self.value <= lower + near:
            return lower
        if upper is not None and self.value >= upper - near:
            return upper
        return None


def _within(least: float, most: float) -> AfterValidator:
    def bounded(found: MeasuredNumber) -> MeasuredNumber:
        if not least <= found.value <= most:
            raise ValueError(f"{found.value:g} must lie in {least:g}…{most:g}")
        return found

    return AfterValidator(bounded)


_EXACT = 0.005  # of spool


class ValveEdge(StrictModel):
    """One direction of a spool. With commanded opening u beyond ``deadband`` (shares of full spool, 0…1):

    joint speed = ``flow_gain`` · f(u − deadband) · nominal speed at full spool, f the identity or ``curve``:
    knots (u − deadband, f) that rise in both, (0, 0) left out, continued with the last slope. ``deadband`` is
    that of the middle of the hysteresis loop: a command that rises opens the edge half the loop later.
    """

    deadband: Annotated[MeasuredNumber, _within(0.0, 0.3)]
    flow_gain: Annotated[MeasuredNumber, _within(0.05, 20.0)]
    curve: tuple[tuple[float, float], ...] = Field(default=(), max_length=CURVE_KNOTS)

    @model_validator(mode="after")
    def _rises(self) -> Self:
        before = (0.0, 0.0)
        for knot in self.curve:
            if not (knot[0] > before[0] and knot[1] > before[1]):
                raise ValueError(f"curve: knot {knot} after {before} does not rise in both")
            before = knot
        return self


class JointValve(StrictModel):
    """The valve of one joint.

    ``raising``, ``lowering``: by the sense in which the joint turns. ``hysteresis``: full width, of spool, by
    which the opening lags a command that turns back. ``delay_ms``: from a command until the spool begins to
    move. ``lag_ms``: the spool's small-signal lag after that. ``full_stroke_ms``: from centre to full.
    """

    raising: ValveEdge
    lowering: ValveEdge
    hysteresis: Annotated[MeasuredNumber, _within(0.0, 0.3)]
    delay_ms: Annotated[MeasuredNumber, _within(0.0, 500.0)]
    lag_ms: Annotated[MeasuredNumber, _within(0.0, 1000.0)]
    full_stroke_ms: Annotated[MeasuredNumber, _within(0.0, 5000.0)]

    @property
    def exact(self) -> bool:
        """Whether it surely passes a small flow steadily: next to no hysteresis."""
        return self.hysteresis.value + self.hysteresis.std < _EXACT


class ValveSet(StrictModel):
    """What is known of a machine's six valves. ``name``: of the set that is fitted, as on its plates.

    ``pressure_compensated``: whether their flow is independent of the load.
    """

    name: str = Field(min_length=1, max_length=40)
    pressure_compensated: bool
    slew: JointValve
    lift: JointValve
    tilt: JointValve
    wrist1: JointValve
    wrist2: JointValve
    wrist3: JointValve

    @property
    def joints(self) -> tuple[JointValve, ...]:
        """The valves of the six joints, in their order."""
        return tuple(getattr(self, name) for name in JOINT_NAMES)


class JointTuning(StrictModel):
    """Gains that commissioning chose; each that is given takes the place of controller.yaml's."""

    gain_1_s: tuple[float, float, float, float, float, float] | None = None


class Basis(StrictModel):
    """What commissioning found the machine with: the arm, and a hash of every number its results rest on."""

    arm: str
    arm_hash: Digest
    controller_hash: Digest


class Commissioned(StrictModel):
    """commissioned.yaml as a whole. ``made_utc``: when, ISO 8601; ``made_by``: command and version."""

    made_utc: str
    made_by: str
    basis: Basis
    valves: ValveSet
    tuning: JointTuning = JointTuning()


class FoundNumber(NamedTuple):
    """A number of a commissioning file with its dotted name."""

    name: str
    number: MeasuredNumber


def found_numbers(model: BaseModel, prefix: str = "") -> Iterator[FoundNumber]:
    """All numbers in ``model`` by their dotted names, in the order in which they are written."""
    for field in type(model).model_fields:
        value = getattr(model, field)
        if isinstance(value, MeasuredNumber):
            yield FoundNumber(prefix + field, value)
        elif isinstance(value, BaseModel):
            yield from found_numbers(value, f"{prefix}{field}.")


def hash_text(model: BaseModel) -> str:
    """``configuration_hash`` as 16 hexadecimal digits."""
    return f"{configuration_hash(model):016x}"


def check_arm(found: Commissioned, arm: NominalArm) -> None:
    """Raise ConfigurationError when ``found`` is not of ``arm`` as it is, or a number sits at its bound.

    Causes: ``commissioned.other_arm``, ``commissioned.stale``, ``commissioned.at_bound``.
    """
    if found.basis.arm != arm.name:
        raise ConfigurationError(
            "commissioned.other_arm", f"commissioned: made for arm '{found.basis.arm}', this is '{arm.name}'"
        )
    if found.basis.arm_hash != hash_text(arm):
        raise ConfigurationError(
            "commissioned.stale",
            f"commissioned: basis.arm_hash = {found.basis.arm_hash}, the arm's file as it is now has "
            f"{hash_text(arm)}: it was changed after {found.made_utc}; commission again",
        )
    for name, number in found_numbers(found):
        bound = number.bound_reached()
        if bound is not None:
            raise ConfigurationError(
                "commissioned.at_bound",
                f"commissioned: {name} = {number.value:g} sits at its bound {bound:g}: it was not found, "
                "the search ended there",
            )
