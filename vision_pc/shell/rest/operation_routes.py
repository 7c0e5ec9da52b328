"""Routes of the operation resources: starting every program, reading, cancelling, and following as events."""

import asyncio
import re
from collections.abc import AsyncIterable, AsyncIterator, Iterable, Sequence
from contextlib import suppress
from difflib import get_close_matches
from http import HTTPStatus
from typing import Annotated, Any, Literal

from fastapi import Body, Depends, FastAPI, Header, Request, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from protocol.errors import RequestRefused
from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import RequestBody
from vision_pc.application.program import Program
from vision_pc.application.results import JSON
from vision_pc.shell.rest.operations import Operation, Operations

MAX_WAIT_S = 3600
MAX_WAITING = 64  # as of those who follow; who comes then is answered at once
_WAIT = re.compile(r'(?:^|,)\s*wait\s*=\s*"?(\d{1,9})"?\s*(?:[;,]|$)', re.IGNORECASE)


def preferred_wait_s(fields: Iterable[str]) -> int | None:
    """The first ``wait`` of the header's fields, at most ``MAX_WAIT_S``; None where there is none.

    What is not understood is ignored, as the RFC wants it.
    """
    found = _WAIT.search(",".join(fields))
    return None if found is None else min(int(found[1]), MAX_WAIT_S)


class Waiting:
    """Those who wait at present."""

    def __init__(self) -> None:
        self._count = 0

    async def for_end(self, operation: Operation, wait_s: int) -> bool:
        """Whether there was a place to wait at: until ``operation`` has ended, or ``wait_s`` have passed."""
        if self._count >= MAX_WAITING:
            return False
        self._count += 1
        try:
            with suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    seen = -1
                    while not operation.state.ended:
                        seen = await operation.changed(seen)
        finally:
            self._count -= 1
        return True


_OPERATION_EXAMPLE: JSON = {
    "id": "5f0c2a9be1d4",
    "kind": "look-then-move",
    "state": "succeeded",
    "progress": 1.0,
    "note": "reached: error +0.5 +0.2 -1.0 mm, inside 5 mm",
    "notes": [[0.0, "looking"], [0.23, "look 1: error -328.8 -65.0 +552.2 mm, outside 5 mm"]],
    "request": {"method": "calibrated", "inputs": 1},
    "created_at": 1.7e9,
    "started_at": 1.7e9,
    "ended_at": 1.700000012e9,
    "result": {
        "error_mm": {"x": 0.47, "y": 0.23, "z": -0.98},
        "std_mm": {"x": 0.2, "y": 0.2, "z": 0.6},
        "tolerance_mm": 5.0,
        "verdict": "inside",
        "certain": True,
        "ended": "reached",
    },
    "problem": None,
}


class OperationView(BaseModel):
    """An operation resource. ``result`` once it has succeeded, ``problem`` (RFC 9457) once it has failed."""

    model_config = ConfigDict(json_schema_extra={"examples": [_OPERATION_EXAMPLE]})

    id: str
    kind: str
    state: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    progress: float = Field(ge=0.0, le=1.0)
    note: str
    notes: list[tuple[float, str]]
    request: JSON
    created_at: float
    started_at: float | None
    ended_at: float | None
    result: JSON | None
    problem: JSON | None


def operation_view(operation: Operation) -> OperationView:
    """The resource of an operation. Times are seconds since 1970."""
    fields = {name: getattr(operation, name) for name in OperationView.model_fields}
    return OperationView.model_construct(  # validated by the loop that answers, not by the one that runs it
        **fields | {"state": operation.state.value, "notes": list(operation.notes)}
    )


MAX_FOLLOWERS = 64  # 400 cost the link nothing, 1,000 its session
_KEY_LIVES = (
    "Same key, same operation, while that is among the newest 200; of an older one 410 `refused.key_spent`, "
    "for the newest 10,000 keys. A restart forgets them; nothing moves then before the arm is enabled again."
)
_WAITS = (
    "With the header `Prefer: wait=N` (RFC 7240) the answer comes when the operation has ended, with 200, or "
    "after N seconds, with 202; it then has `Preference-Applied`. A client that goes away ends nothing."
)
_TEXT = {"schema": {"type": "string"}}
_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "It has ended: succeeded, failed or cancelled",
        "headers": {"Location": _TEXT, "Preference-Applied": _TEXT},
        "model": OperationView,
    },
    202: {"headers": {"Location": _TEXT, "Preference-Applied": _TEXT}},
}
_Key = Annotated[
    str | None,
    Header(alias="Idempotency-Key", min_length=1, max_length=100, description=_KEY_LIVES),
]


def add_programs(
    app: FastAPI,
    application: VisionApplication,
    operations: Operations,
    programs: Iterable[Program[Any, Any]],
) -> None:
    """Adds a route for each program; a body may be left out where nothing in it is wanted."""
    waiting = Waiting()
    for program in programs:
        _add_program(app, application, operations, program, waiting)


def add_unknown(app: FastAPI, known: Sequence[str]) -> None:
    """Adds the refusal of a program that is none of ``known``; after all others."""

    @app.post("/operations/{name}", include_in_schema=False)
    async def unknown(name: str) -> None:
        close = get_close_matches(name, known, 1)
        hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(known)}"
        raise RequestRefused("refused.unknown_program", f"no program '{name}'; {hint}")


def _add_program(
    app: FastAPI,
    application: VisionApplication,
    operations: Operations,
    program: Program[Any, Any],
    waiting: Waiting,
) -> None:
    nothing = _empty(program.body)
    left_out: Any = Body() if nothing is None else None  # FastAPI's mark of a body that is wanted

    async def start(
        request: Request, response: Response, body: Any = left_out, key: _Key = None
    ) -> OperationView:
        if len(request.headers.getlist("idempotency-key")) > 1:
            raise RequestRefused("request.repeated_header", "Idempotency-Key is there more than once")
        operation = operations.start(program, application, body or nothing, key)
        response.headers["Location"] = f"/operations/{operation.id}"
        wait_s = preferred_wait_s(request.headers.getlist("prefer"))
        if wait_s is not None and await waiting.for_end(operation, wait_s):
            response.headers["Preference-Applied"] = f"wait={wait_s}"
            response.status_code = HTTPStatus.OK if operation.state.ended else HTTPStatus.ACCEPTED
        return operation_view(operation)

    start.__annotations__["body"] = program.body if nothing is None else program.body | None
    app.post(
        f"/operations/{program.name}",
        tags=[program.tag],
        summary=program.title,
        status_code=HTTPStatus.ACCEPTED,
        description=_WAITS,
        operation_id=program.name.replace("-", "_"),
        responses=_ANSWERS,
    )(start)


def _empty(body: type[RequestBody]) -> Any:
    """The body that says nothing, None where something must be said."""
    try:
        return body()
    except ValidationError:
        return None


class ProgressEvent(BaseModel):
    """Data of a ``progress`` event."""

    progress: float
    note: str


class _Followers:
    """How many follow the events of an operation at present."""

    def __init__(self) -> None:
        self._count = 0

    async def place(self) -> AsyncIterator[None]:
        """One place among the followers for as long as the response lasts."""
        if self._count >= MAX_FOLLOWERS:
            why = f"{MAX_FOLLOWERS} clients follow already; read the operation instead"
            raise RequestRefused("refused.too_many_followers", why)
        self._count += 1
        try:
            yield
        finally:
            self._count -= 1


def add_resources(app: FastAPI, operations: Operations) -> None:
    """Adds reading, cancelling and following operations to ``app``."""

    async def found(operation_id: str) -> Operation:
        return operations.get(operation_id)

    Found = Annotated[Operation, Depends(found)]
    followers = _Followers()

    @app.get("/operations", tags=["operations"], summary="All operations, oldest first")
    async def every() -> list[OperationView]:
        return [operation_view(operation) for operation in operations.list()]

    @app.get("/operations/{operation_id}", tags=["operations"], summary="One operation")
    async def one(operation: Found) -> OperationView:
        return operation_view(operation)

    @app.post("/operations/{operation_id}/cancel", tags=["operations"], summary="End it and stop the arm")
    async def cancel(operation: Found) -> OperationView:
        """409 when it has already ended."""
        return operation_view(await operations.cancel(operation.id))

    @app.get("/operations/{operation_id}/events", tags=["operations"], summary="Follow it (event stream)",
             response_class=EventSourceResponse, dependencies=[Depends(followers.place)])  # fmt: skip
    async def events(operation: Found) -> AsyncIterable[ServerSentEvent]:
        """``progress`` events, then one ``ended`` with the whole operation."""
        sent, seen = 0, -1
        while True:
            seen = await operation.changed(seen)
            for progress, note in operation.notes[sent:]:
                sent += 1
                yield ServerSentEvent(
                    event="progress", id=str(sent), data=ProgressEvent(progress=progress, note=note)
                )
            if operation.state.ended:
                yield ServerSentEvent(event="ended", data=operation_view(operation))
                return
