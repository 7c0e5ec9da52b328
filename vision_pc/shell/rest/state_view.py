"""The controller's state as the API shows it; units stand in the keys."""

import math

from pydantic import BaseModel, Field

from protocol.channel import LinkStatistics
from protocol.reference_messages import FLAG_EMERGENCY_LATCHED, FLAG_PLANT_LINK_OK, FLAG_SETTLED, State
from vision_pc.application.application import VisionApplication
from vision_pc.application.console.overview import session_state
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.application.results import JSON, pose_json
from vision_pc.core.se3 import from_pose


class ClockView(BaseModel):
    """The controller's clock against this one."""

    offset_ns: int = Field(description="ns: controller's clock minus this one")
    uncertainty_ns: int = Field(description="ns: bound on the error of offset_ns, whatever the delays")
    round_trip_us: float = Field(description="µs: the newest heartbeat's way there and back")


class FarSide(BaseModel):
    """The same link as the controller counts it, from its newest state."""

    references_lost: int = Field(description="datagrams of this side that never came")
    references_dropped: int = Field(description="datagrams of this side that came and were not used")


class LinkTrouble(BaseModel):
    """Why there is no session."""

    cause: str = Field(description="machine-readable, such as link.wrong_arm", examples=["link.wrong_arm"])
    detail: str = Field(description="the same in words, with the controller's address")


class LinkView(BaseModel):
    """The reference link: whether it is open and authenticated, and its counters on both sides."""

    connected: bool = Field(description="a session is open; a state and the clock have come in it")
    authenticated: bool = Field(description="every datagram of the open session is signed")
    tries_valves: bool = Field(
        description="POST /enable alone begins a trial of the valves: the controller was started for that"
    )
    trouble: LinkTrouble | None = Field(description="none with a session")
    state_age_ms: float | None = Field(description="ms since the newest state; none without one")
    datagrams: LinkStatistics = Field(description="each counted once, under what became of it")
    dropped: int = Field(description="datagrams that came and were not used, for any cause")
    clock: ClockView | None = Field(description="none before the first heartbeat's echo")
    controller: FarSide | None = Field(description="none without a session")


def link_view(link: ReferenceLink) -> LinkView:
    """The link as it is now; never raises, for it is asked when something is wrong."""
    tally, clock, far = link.session.statistics, link.session.clock, None
    state, lost = session_state(link)
    if state is not None:
        far = FarSide(references_lost=state.references_lost, references_dropped=state.references_dropped)
    return LinkView(
        connected=link.connected,
        authenticated=link.session.authenticated,
        tries_valves=link.tries_valves,
        trouble=None if lost is None else LinkTrouble(cause=lost.cause, detail=str(lost)),
        state_age_ms=None if far is None else round(link.state_age_ns / 1e6, 3),
        datagrams=tally,
        dropped=tally.dropped,
        clock=None
        if clock is None
        else ClockView(
            offset_ns=clock.offset_ns,
            uncertainty_ns=clock.uncertainty_ns,
            round_trip_us=clock.round_trip_ns / 1e3,
        ),
        controller=far,
    )


def state_json(application: VisionApplication) -> JSON:
    """The controller's newest state, the links and the camera. Raises LinkLost without a controller."""
    state = application.controller.state
    clock = application.controller.session.clock
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
