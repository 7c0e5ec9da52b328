"""The reference link in numbers, as ``GET /link`` shows it; units stand in the keys or the descriptions."""

from dataclasses import asdict

from pydantic import BaseModel, Field

from protocol.errors import LinkLost
from vision_pc.application.ports import Controller


class LinkCounters(BaseModel):
    """Datagrams from the controller since this program started, each counted once under what became of it."""

    received: int = Field(description="datagrams: intact, in order, fresh, and used")
    lost: int = Field(description="datagrams: skipped numbers that have not come (late ones are taken off)")
    longest_gap: int = Field(description="datagrams: most lost in a row")
    duplicated: int = Field(description="datagrams: came before, in a link without authentication")
    reordered: int = Field(description="datagrams: came after a newer one, or leapt too far ahead; not used")
    stale: int = Field(description="datagrams: older than the link timeout when they were read")
    refused: int = Field(description="datagrams: not of the written protocol (size, magic, CRC, range)")
    foreign: int = Field(description="datagrams: of another session, source, minor version or direction")
    not_authenticated: int = Field(description="datagrams: without a tag although a key is configured")
    key_not_configured: int = Field(description="datagrams: with a tag although no key is configured")
    unknown_key: int = Field(description="datagrams: signed with another key")
    bad_tag: int = Field(description="datagrams: whose tag does not fit their content, session or direction")
    replayed: int = Field(description="datagrams: came before, in an authenticated link")
    too_old: int = Field(description="datagrams: behind the replay window of 64 numbers")
    echoes_refused: int = Field(description="answers to heartbeats that were not used for the clock's offset")


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

    connected: bool = Field(description="a session is open and a state has come in it")
    authenticated: bool = Field(description="every datagram of the open session is signed")
    tries_valves: bool = Field(
        description="POST /enable alone begins a trial of the valves: the controller was started for that"
    )
    trouble: LinkTrouble | None = Field(description="none with a session")
    state_age_ms: float | None = Field(description="ms since the newest state; none without one")
    datagrams: LinkCounters
    dropped: int = Field(description="datagrams that came and were not used, for any cause")
    clock: ClockView | None = Field(description="none before the first heartbeat's echo")
    controller: FarSide | None = Field(description="none without a session")


def link_view(link: Controller) -> LinkView:
    """The link as it is now; never raises, for it is asked when something is wrong."""
    tally, clock = link.statistics, link.clock_offset
    trouble = None
    try:
        state = link.state
        far = FarSide(references_lost=state.references_lost, references_dropped=state.references_dropped)
    except LinkLost as error:
        far, trouble = None, LinkTrouble(cause=error.cause, detail=str(error))
    return LinkView(
        connected=link.connected,
        authenticated=link.authenticated,
        tries_valves=link.tries_valves,
        trouble=trouble,
        state_age_ms=None if far is None else round(link.state_age_ns / 1e6, 3),
        datagrams=LinkCounters(**asdict(tally)),
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
