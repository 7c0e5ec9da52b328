"""The controller's state as the API shows it; units stand in the keys."""

import math

from protocol.reference_messages import FLAG_EMERGENCY_LATCHED, FLAG_PLANT_LINK_OK, FLAG_SETTLED, State
from vision_pc.application.application import VisionApplication
from vision_pc.application.results import JSON, pose_json
from vision_pc.core.se3 import from_pose


def state_json(application: VisionApplication) -> JSON:
    """The controller's newest state, the links and the camera. Raises LinkLost without a controller."""
    state = application.controller.state
    clock = application.controller.clock_offset
    camera = application.camera.status()
    return arm_json(state) | {
        "link": {
            "age_ms": round(application.controller.state_age_ns / 1e6, 3),
            "clock_offset_ns": None if clock is None else clock.offset_ns,
            "clock_uncertainty_ns": None if clock is None else clock.uncertainty_ns,
            "round_trip_us": None if clock is None else clock.round_trip_ns / 1e3,
        },
        "camera": camera._asdict(),
    }


def arm_json(state: State) -> JSON:
    """A state of the controller: group state, fault, joints (degrees), poses, valves, timing."""

    def joints_deg(values: tuple[float, ...]) -> list[float]:
        return [round(math.degrees(v), 5) for v in values]

    return {
        "group_state": state.group_state.name.lower(),
        "fault": state.fault.name.lower(),
        "severity": state.severity.name.lower(),
        "emergency_latched": bool(state.flags & FLAG_EMERGENCY_LATCHED),
        "plant_link_ok": bool(state.flags & FLAG_PLANT_LINK_OK),
        "settled": bool(state.flags & FLAG_SETTLED),
        "motion": {"id": state.motion_id, "done": state.motion_done, "segment": state.segment},
        "q_meas_deg": joints_deg(state.q_meas),
        "q_cmd_deg": joints_deg(state.q_cmd),
        "valves": list(state.valves),
        "X_BT": pose_json(from_pose(state.X_BT)),
        "X_BT_cmd": pose_json(from_pose(state.X_BT_cmd)),
        "supply_bar": state.supply_bar,
        "cycle": {
            "count": state.cycle,
            "overruns": state.overruns,
            "lateness_p50_us": state.lateness_p50_us,
            "lateness_p99_us": state.lateness_p99_us,
            "lateness_max_us": state.lateness_max_us,
            "plant_exchange_failures": state.plant_exchange_failures,
        },
        "references_lost": state.references_lost,
        "references_dropped": state.references_dropped,
    }
