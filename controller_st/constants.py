"""The constants of the program as text: what arm.yaml, controller.yaml and the protocol's tables say.

The program knows no parking, no trial of the valves and no load-holding valves: a configuration that asks for
them is refused.
"""

import math
import zlib
from collections.abc import Iterable
from enum import IntEnum
from typing import Any

import numpy as np

from controller.config import ControllerConfig
from controller.core.group_states import TRANSITIONS, Stimulus
from controller.core.kinematics.inverse_kinematics import geometry
from controller.core.servo.settling import ERROR_FILTER_S, STILL
from controller.core.settings import ScanSettings, settings_from
from controller.core.standing import MOVED
from foundation.configuration import configuration_hash
from nominal_arm.description import NominalArm
from protocol.axes_group import GROUP_STATE, Mode
from protocol.datagram_layout import PAYLOADS, Kind, size_of
from protocol.errors import ConfigurationError
from protocol.faults import CommandCode, FaultCode, Reason, Severity

# After PLCopen's group states; what it has not comes with the same beginning.
MODES = {
    Mode.DISABLED: "GroupDisabled",
    Mode.STANDBY: "GroupStandby",
    Mode.MOVING: "GroupMoving",
    Mode.STREAMING: "GroupStreaming",
    Mode.STOPPING: "GroupStopping",
    Mode.DISABLING: "GroupDisabling",
    Mode.ERROR_RAMP: "GroupErrorStopping",
    Mode.ERROR_HELD: "GroupErrorStop",
    Mode.EMERGENCY: "GroupEmergencyStop",
}
_SEAL = "(* CRC of all above: "
_HEAD = """\
(* Longreach: what configs/arm.yaml, configs/controller.yaml and the tables of docs/protocol.md say.
   Made from them: python -m tools.pages *)
"""


def refuse_what_is_left_out(config: ControllerConfig) -> None:
    """Raise ConfigurationError for a configuration of what the program does not have."""
    valves = config.valves
    left_out = {
        "controller.parking.enabled": config.parks,
        "controller.excitation.enabled": config.excitation.enabled,
        "controller.reference_link.link_key": any(config.reference_link.link_key.model_dump().values()),
        "controller.valves.pressure_compensated": valves.pressure_compensated,
        "controller.valves: hysteresis": any(each.hysteresis.value > 0.0 for each in valves.joints),
    }
    for key, requests in left_out.items():
        if requests:
            raise ConfigurationError(
                "controller_st.left_out", f"{key}: the controller in structured text has no such part"
            )


def constants_text(arm: NominalArm, config: ControllerConfig) -> str:
    """The text. Raises ConfigurationError, also for what the program does not have."""
    settings = settings_from(arm, config)
    refuse_what_is_left_out(config)
    parts = [_HEAD, "TYPE", _enumeration("E_LR_Mode", {MODES[m]: m.value for m in Mode}, "UINT")]
    # MOVE is a word of CODESYS.
    requests = {each.name.replace("MOVE", "MOTION"): place for place, each in enumerate(Stimulus)}
    parts.append(_enumeration("E_LR_Request", requests, "UINT"))
    parts += [
        _enumeration(f"E_LR_{name}", {each.name: each.value for each in of}, base)
        for name, of, base in (
            ("Reason", Reason, "UDINT"), ("Fault", FaultCode, "UINT"), ("Severity", Severity, "UINT"),
            ("Command", CommandCode, "UDINT"), ("Kind", Kind, "USINT"),
        )
    ]  # fmt: skip
    parts += ["END_TYPE", "", "VAR_GLOBAL CONSTANT"]
    parts += [
        f"    {line}" for line in (*_tables(), *_link(arm, config), *_arm(settings), *_limits(settings))
    ]
    made = "\n".join([*parts, "END_VAR", ""])
    return made + _seal(made)


def refuse_edited(text: str) -> None:
    """Raise ConfigurationError for constants that were changed by hand: they are made anew at every start."""
    made, mark, _ = text.rpartition(_SEAL)
    if not mark or made + _seal(made) != text:
        why = (
            "plc/constants.st was edited, which changes nothing: it is made from arm.yaml and controller.yaml"
        )
        raise ConfigurationError("controller_st.edited_constants", f"{why}; change those, or use --set")


def _seal(text: str) -> str:
    return f"{_SEAL}{zlib.crc32(text.encode()):08X} *)\n"


def _enumeration(name: str, values: dict[str, int], base: str) -> str:
    inside = ", ".join(f"{each} := {value}" for each, value in values.items())
    return f"{name} : ({inside}) {base};"


def _tables() -> Iterable[str]:
    modes, requests = len(Mode) - 1, len(Stimulus) - 1
    for what, of in (("NEXT", "E_LR_Mode"), ("ANSWER", "E_LR_Reason")):
        rows = []
        for mode in Mode:
            steps = [TRANSITIONS[mode, each] for each in Stimulus]
            cells = [MODES[s.mode] if what == "NEXT" else s.reason.name for s in steps]
            rows.append("[" + ", ".join(f"{of}.{cell}" for cell in cells) + "]")
        yield f"LR_{what} : ARRAY[0..{modes}, 0..{requests}] OF {of} := [{', '.join(rows)}];"
    yield _array("LR_GROUP_STATE", "UINT", [GROUP_STATE[mode].value for mode in Mode])
    sizes = [0, *(size_of(PAYLOADS[kind]) for kind in Kind)]
    yield _array("LR_PAYLOAD_BYTES", "UINT", sizes)
    reasons: type[IntEnum] = Reason
    yield _array("LR_IS_REASON", "BOOL", [str(k in set(reasons)).upper() for k in range(max(Reason) + 1)])


def _link(arm: NominalArm, config: ControllerConfig) -> Iterable[str]:
    yield f"LR_ARM_HASH : ULINT := 16#{configuration_hash(arm):016X};"
    yield f"LR_CYCLE_NS : ULINT := {round(1e6 * config.cycle_ms)};"
    yield f"LR_LINK_TIMEOUT_MS : UDINT := {config.reference_link.link_timeout_ms};"


def _arm(settings: ScanSettings) -> Iterable[str]:
    yield _array("LR_DH", "LREAL", settings.table)
    shape = geometry(settings.table)
    yield _array("LR_IK_OFFSETS", "LREAL", shape.offsets)
    for name in ("aside", "height", "inner", "outer", "bend", "hand", "s6", "c6", "s7", "c7"):
        yield _number(f"LR_IK_{name.upper()}", getattr(shape, name))
    servo, joints = settings.servo, settings.servo.joints
    yield _array("LR_DRIVES", "LREAL", servo.drives)
    yield _number("LR_RATED_SUPPLY", servo.rated.supply)
    yield _number("LR_RATED_RETURN", servo.rated.back)
    yield f"LR_LOAD_COMPENSATION : BOOL := {str(settings.load_compensation).upper()};"
    for name in ("gain", "time_constant", "damping", "deadband", "flow_gain", "blend", "curve"):
        yield _array(f"LR_{name.upper()}", "LREAL", getattr(joints, name))
    for name in ("feed_forward", "high_pass", "limit"):
        yield _number(f"LR_SERVO_{name.upper()}", getattr(joints, name))
    yield from _all("POSE", servo.gains)
    yield _number("LR_SETTLED_DEAD_ZONE", servo.dead_zone)
    yield _number("LR_SETTLED_TOLERANCE", servo.tolerance)
    yield _number("LR_SETTLED_STILL", STILL * servo.tolerance)
    yield _number("LR_SETTLED_MOVED", MOVED * servo.tolerance)
    yield _number("LR_SETTLED_FILTER", ERROR_FILTER_S)
    yield _number("LR_SETTLED_TIME", settings.settled.time)


def _limits(settings: ScanSettings) -> Iterable[str]:
    planning, streaming = settings.planning, settings.streaming
    yield _array("LR_PLANNED_RANGE", "LREAL", planning.planned_range)
    yield _array("LR_JOINT_SPEEDS", "LREAL", planning.joint_speeds)
    yield _array("LR_WORKSPACE", "LREAL", planning.workspace.box)
    yield _number("LR_WORKSPACE_RADIUS", planning.workspace.radius_min)
    yield _number("LR_SINGULAR_VALUE_MIN", planning.singular_value_min)
    yield _array("LR_PEAKS", "LREAL", settings.motion.of_peaks())
    yield from _all("MOTION", settings.motion)
    yield from _all("STOP", settings.stop)
    yield from _all("STREAM", streaming.axes)
    yield from _all("STREAM", streaming)
    yield from _all("WATCH", settings.supervision)


def _all(prefix: str, bundle: Any) -> Iterable[str]:
    """Every number and array of a bundle, of a workspace its box and radius; the axes have a bundle."""
    for name, value in bundle._asdict().items():
        if name == "workspace":
            yield _array(f"LR_{prefix}_WORKSPACE", "LREAL", value.box)
            yield _number(f"LR_{prefix}_WORKSPACE_RADIUS", value.radius_min)
        elif name != "axes":
            made = f"LR_{prefix}_{name.upper()}"
            yield _number(made, value) if np.ndim(value) == 0 else _array(made, "LREAL", value)


def _number(name: str, value: float) -> str:
    return f"{name} : LREAL := {_real(value)};"


def _real(value: float) -> str:
    """A number in full; the language wants a decimal point."""
    assert math.isfinite(value)
    mantissa, exponent, power = repr(float(value)).partition("e")
    return (mantissa if "." in mantissa else mantissa + ".0") + exponent.upper() + power


def _array(name: str, of: str, values: Any) -> str:
    found = np.asarray(values, dtype=float if of == "LREAL" else object)
    bounds = ", ".join(f"0..{length - 1}" for length in found.shape)
    inside = ", ".join(_real(value) if of == "LREAL" else str(value) for value in found.ravel().tolist())
    return f"{name} : ARRAY[{bounds}] OF {of} := [{inside}];"
