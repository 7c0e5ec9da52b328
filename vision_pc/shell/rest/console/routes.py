"""The console's routes: its page, one stream of state, one of pictures, and who is asking.

They run in the loop that speaks HTTP. Only ``glimpse``, which copies references, runs where the link is.
"""

import asyncio
import contextlib
import json
import time
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib.resources import files
from typing import Any, TypeVar

import numpy as np
from fastapi import FastAPI, Request
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field

from foundation.rest.files import Home, PageFiles, add_files
from foundation.rest.tokens import Role
from protocol.errors import LongreachError
from protocol.reference_messages import State
from vision_pc.application.application import VisionApplication
from vision_pc.application.console.advice import advice
from vision_pc.application.console.overview import Glimpse, Overview, ellipse_of, glimpse, told_by
from vision_pc.application.console.pace import MeasuringPace
from vision_pc.application.results import JSON
from vision_pc.shell.rest.console.broadcast import Broadcast
from vision_pc.shell.rest.console.pictures import PICTURE_PERIOD_S, LivePictures
from vision_pc.shell.rest.operations import Operation, Operations
from vision_pc.shell.rest.state_view import arm_json

T = TypeVar("T")
_STATE_PERIOD_S = 0.1
_MOST_OF_STATE, _MOST_OF_PICTURES = 64, 16
_OPERATIONS_SHOWN = 8
_TAG: list[Any] = ["console"]

PAGE = PageFiles(files("vision_pc.shell.rest.console") / "page", "/console", "/")


class AccessView(BaseModel):
    """Who is asking."""

    role: Role = Field(description="look: may read and stop; operate: everything")
    token_wanted: bool = Field(description="whether this service asks for a token at all")
    emulator_face: str | None = Field(
        None, description="address of the emulator's own HTTP face; for the console"
    )


class Console:
    """What all open consoles share."""

    def __init__(
        self, application: VisionApplication, operations: Operations, overview: Overview, home: Home | None
    ) -> None:
        self._application, self._operations, self._overview, self._home = (
            application, operations, overview, home
        )  # fmt: skip
        self._instance = uuid.uuid4().hex[:8]
        self._started_s = time.time()
        self._number = 0
        self._failed: set[str] = set()
        self._pace = MeasuringPace()
        self._measuring: asyncio.Task[None] | None = None
        pictures = LivePictures(self._pair_after)
        self.state = Broadcast(self._snapshot, _STATE_PERIOD_S, _MOST_OF_STATE, "the state")
        self.pictures = Broadcast(pictures.next_message, PICTURE_PERIOD_S, _MOST_OF_PICTURES, "the pictures")

    async def _at_home(self, function: Callable[..., Awaitable[T]], *given: Any) -> T:
        return await (function(*given) if self._home is None else self._home.call(function, *given))

    async def _pair_after(self, capture_ns: int) -> Any:
        return await self._at_home(self._application.camera.pair_after, capture_ns)

    async def _glimpse(self) -> tuple[Glimpse, list[Operation]]:
        return glimpse(self._application), self._operations.list()[-_OPERATIONS_SHOWN:]

    async def _snapshot(self) -> bytes:
        """The next event of the stream of state."""
        seen, operations = await self._at_home(self._glimpse)
        now_s = time.time()
        self._overview.note(now_s, seen)
        self._note_failures(operations)
        if self.pictures.followers and (not operations or operations[-1].state.ended):
            self._measure_when_due(now_s, seen.state)
        self._number += 1
        anew_s = self._overview.anew_at or 0.0
        told = _told([each for each in operations if (each.ended_at or now_s) >= anew_s])
        document = {
            "number": self._number,
            "time": now_s,
            "service": {"instance": self._instance, "started_at": self._started_s},
            "watchers": self.state.followers,
            "state": None if seen.state is None else arm_json(seen.state),
            "operations": [_operation_json(operation) for operation in operations],
            "told": told,
            "looked_at": None if seen.look is None else now_s - _age_s(seen.look.look.time_ns),
        } | self._overview.document(seen, ellipse_of(told))
        data = json.dumps(document, separators=(",", ":"), allow_nan=False)
        return f"id: {self._number}\nevent: snapshot\ndata: {data}\n\n".encode()

    def _note_failures(self, operations: list[Operation]) -> None:
        for operation in operations:
            if operation.problem is not None and operation.id not in self._failed:
                ended_s = operation.ended_at or time.time()
                problem = operation.problem
                detail = f"{operation.kind}: {problem['detail']}"
                self._overview.alarms.happened(ended_s, str(problem["cause"]), detail)
        self._failed = {operation.id for operation in operations if operation.problem is not None}

    def _measure_when_due(self, now_s: float, state: State | None) -> None:
        """Have markers looked for in the newest picture; while a program runs it does so."""
        if self._measuring is not None and not self._measuring.done():
            return
        if self._pace.due(now_s, None if state is None else np.array(state.q_meas)):
            self._measuring = asyncio.create_task(self._measure())

    async def _measure(self) -> None:
        with contextlib.suppress(LongreachError):
            await self._at_home(self._application.camera.observe)


def add_console(app: FastAPI, console: Console, emulator_face: str = "") -> None:
    """Adds the page at ``/`` and what it lives on to ``app``. ``emulator_face``: an address it may ask."""
    add_files(app, PAGE, emulator_face)

    @app.get("/access", tags=_TAG, summary="What the token that was sent lets its holder do")
    async def access(request: Request) -> AccessView:
        """Where no token is wanted, everybody operates."""
        role = request.scope.get("longreach.role")
        role_now, wanted = role or Role.OPERATE, role is not None
        return AccessView(role=role_now, token_wanted=wanted, emulator_face=emulator_face or None)

    @app.get("/events", tags=_TAG, summary="All that a console shows, ten times a second (event stream)",
             response_class=StreamingResponse,
             responses={200: {"content": {"text/event-stream": {}}}})  # fmt: skip
    async def events() -> StreamingResponse:
        """``snapshot`` events: state, links, operations, the newest look, alarms with what to do."""
        console.state.refuse_more()
        return StreamingResponse(console.state.follow(), media_type="text/event-stream")

    @app.get("/camera/live", tags=_TAG, summary="Live pictures of both eyes, at most ten a second",
             response_class=StreamingResponse,
             responses={200: {"content": {"application/octet-stream": {}}}})  # fmt: skip
    async def live() -> StreamingResponse:
        """Messages one after another, little endian: u32 bytes that follow, u64 capture and u64 encoding time
        (ns), u32 frame, u32 bytes of the left eye; then the left eye's JPEG, and the right one's at half
        size. A client that is slow skips pictures.
        """
        console.pictures.refuse_more()
        return StreamingResponse(_endless(console.pictures), media_type="application/octet-stream")


async def _endless(pictures: Broadcast) -> AsyncIterator[bytes]:
    async for each in pictures.follow():
        yield each


def _age_s(captured_ns: int) -> float:
    return 1e-9 * (time.monotonic_ns() - captured_ns)


def _told(operations: list[Operation]) -> JSON | None:
    """What the newest operation told of where it would end; nothing once something else has moved the arm."""
    moving = [operation for operation in operations if operation.kind != "look"]
    return told_by(moving[-1].kind, moving[-1].result) if moving else None


def _operation_json(operation: Operation) -> JSON:
    cause = None if operation.problem is None else str(operation.problem["cause"])
    return {
        "id": operation.id,
        "kind": operation.kind,
        "state": operation.state.value,
        "request": operation.request,
        "progress": round(operation.progress, 4),
        "note": operation.note,
        "started_at": operation.started_at,
        "ended_at": operation.ended_at,
        "cause": cause,
        "advice": None if cause is None else advice(cause),
    }
