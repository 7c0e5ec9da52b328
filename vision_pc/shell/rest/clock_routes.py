"""The plant's clock over REST: how fast it goes, who is waited for; it is held and let go here."""

from collections.abc import AsyncIterator, Callable, Collection
from typing import Any

from fastapi import FastAPI, Request
from pydantic import BaseModel, Field

from vision_pc.application.results import JSON
from vision_pc.shell.machine_clock import Goes, MachineClock

_PATH = "/clock"
_READS = frozenset({"GET", "HEAD", "OPTIONS"})


class StandingView(BaseModel):
    """Why the time of all stands."""

    waits_for: str = Field(description="the part that does not answer")
    seconds: float = Field(description="s of wall time, since when")


class MachineClockView(BaseModel):
    """The clock that everything at the machine goes by."""

    source: str = Field(description="plant: simulated time, as fast as all parts answer; wall: real time")
    goes: Goes = Field(description="always; on_request: while a request or an operation is under way; never")
    pace: float = Field(description="times real time, over the last second")
    time_ns: int = Field(description="ns: the time of this service")
    standing: StandingView | None = Field(description="null while all parts answer")


class GoesBody(BaseModel):
    """When it shall go."""

    goes: Goes


def clock_view(machine: MachineClock) -> MachineClockView:
    """The clock as the API shows it."""
    standing = machine.standing
    return MachineClockView(
        source="plant" if machine.of_plant else "wall",
        goes=machine.goes,
        pace=round(machine.pace, 3),
        time_ns=machine.now_ns,
        standing=None if standing is None else StandingView(**standing._asdict()),
    )


def clock_json(machine: MachineClock) -> JSON:
    """The same as JSON."""
    return clock_view(machine).model_dump(mode="json")


def stands_words(machine: MachineClock) -> list[str]:
    """Why the time of all stands, none or one line."""
    stands = machine.standing
    words = "{} has not answered the plant's clock for {:.0f} s: the time of all stands"
    return [] if stands is None else [f"clock.unanswered: {words.format(*stands)}"]


def while_requested(machine: MachineClock, stops: Collection[str]) -> Callable[[Request], Any]:
    """A dependency: time passes while a request is under way that is no reading and not about the clock.

    Where it does not pass at all, it raises RequestRefused (``refused.clock_held``), for a stop never.
    """

    async def requested(request: Request) -> AsyncIterator[None]:
        path = request.url.path
        if path in stops:
            machine.stopped()
        if request.method in _READS or path == _PATH or path in stops:
            yield
            return
        async with machine.requested():
            yield

    return requested


def add_clock(app: FastAPI, machine: MachineClock) -> None:
    """Adds reading and setting the clock to ``app``."""

    @app.get(_PATH, tags=["state"], summary="The clock: its pace, and who is waited for")
    async def read() -> MachineClockView:
        """Always answered."""
        return clock_view(machine)

    @app.put(_PATH, tags=["state"], summary="Hold the plant's clock, or let it go")
    async def let_go(body: GoesBody) -> MachineClockView:
        """409 ``refused.wall_clock`` where real time is the machine's."""
        machine.let_go(body.goes)
        return clock_view(machine)
