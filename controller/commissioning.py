"""The controller's configuration with what commissioning found in place of what was believed before."""

from controller.config import ControllerConfig, JointControlConfig
from foundation.configuration import StrictModel, validated
from nominal_arm.commissioned import Basis, ValveSet, check_arm, hash_text
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError


class _FoundWith(StrictModel):
    """What the numbers of a commissioning rest on; a change of any of them makes them worthless."""

    cycle_ms: float
    valves: ValveSet
    joint_control: JointControlConfig


def basis_of(arm: NominalArm, config: ControllerConfig) -> Basis:
    """What commissioning writes of the configuration that it was made with."""
    found_with = _FoundWith(
        cycle_ms=config.cycle_ms, valves=config.valves, joint_control=config.joint_control
    )
    return Basis(arm=arm.name, arm_hash=hash_text(arm), controller_hash=hash_text(found_with))


def commissioned_config(arm: NominalArm, config: ControllerConfig) -> ControllerConfig:
    """``config`` with the valves and gains of its commissioning; ``config`` itself where there is none.

    Raises ConfigurationError for a commissioning of another arm (``commissioned.other_arm``), of another
    valve set (``commissioned.other_valves``), older than a change of what it rests on
    (``commissioned.stale``), with a number at its bound (``commissioned.at_bound``), or with a gain that
    controller.yaml could not have.
    """
    found = config.commissioned
    if found is None:
        return config
    check_arm(found, arm)
    if found.valves.name != config.valves.name:
        raise ConfigurationError(
            "commissioned.other_valves",
            f"commissioned: made with valve set '{found.valves.name}', controller.valves.name is "
            f"'{config.valves.name}'",
        )
    now = basis_of(arm, config).controller_hash
    if found.basis.controller_hash != now:
        raise ConfigurationError(
            "commissioned.stale",
            f"commissioned: basis.controller_hash = {found.basis.controller_hash}, cycle_ms, valves and "
            f"joint_control as they are now have {now}: one was changed after {found.made_utc}; "
            "commission again",
        )
    tuned = config.joint_control.model_dump() | found.tuning.model_dump(exclude_none=True)
    joint_control = validated(JointControlConfig, tuned, "commissioned: tuning")
    return config.model_copy(update={"valves": found.valves, "joint_control": joint_control})
