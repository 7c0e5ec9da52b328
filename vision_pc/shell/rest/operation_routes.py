"""Routes of the operation resources: starting every program, reading and cancelling."""

import asyncio
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from difflib import get_close_matches
from http import HTTPStatus
from typing import Annotated, Any

from fastapi import Body, Depends, FastAPI, Header, Request, Response
from pydantic import ValidationError

from protocol.errors import RequestRefused
from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import RequestBody
from vision_pc.application.program import Program
from vision_pc.shell.rest.operations import Operation, Operations

MAX_WAIT_S = 3600
_WAIT = re.compile(r'(?:^|,)\s*wait\s*=\s*"?(\d{1,9})"?\s*(?:[;,]|$)', re.IGNORECASE)


def preferred_wait_s(fields: Iterable[str]) -> int | None:
    """The first ``wait`` of the header's fields, at most ``MAX_WAIT_S``; None where there is none.

    What is not understood is ignored, as the RFC wants it.
    """
    found = _WAIT.search(",".join(fields))
    return None if found is None else min(int(found[1]), MAX_WAIT_S)


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
        "model": Operation,
    },
    202: {"headers": {"Location": _TEXT, "Preference-Applied": _TEXT}},
}
_Key = Annotated[
    str | None, Header(alias="Idempotency-Key", min_length=1, max_length=100, description=_KEY_LIVES)
]


def add_programs(
    app: FastAPI,
    application: VisionApplication,
    operations: Operations,
    programs: Iterable[Program[Any, Any]],
) -> None:
    """Adds a route for each program; a body may be left out where nothing in it is wanted."""
    for program in programs:
        _add_program(app, application, operations, program)


def add_unknown(app: FastAPI, known: Sequence[str]) -> None:
    """Adds the refusal of a program that is none of ``known``; after all others."""

    @app.post("/operations/{name}", include_in_schema=False)
    async def unknown(name: str) -> None:
        close = get_close_matches(name, known, 1)
        hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(known)}"
        raise RequestRefused("refused.unknown_program", f"no program '{name}'; {hint}")


def _add_program(
    app: FastAPI, application: VisionApplication, operations: Operations, program: Program[Any, Any]
) -> None:
    nothing = _empty(program.body)
    left_out: Any = Body() if nothing is None else None  # FastAPI's mark of a body that is wanted

    async def start(
        request: Request, response: Response, body: Any = left_out, key: _Key = None
    ) -> Operation:
        if len(request.headers.getlist("idempotency-key")) > 1:
            raise RequestRefused("request.repeated_header", "Idempotency-Key is there more than once")
        operation = operations.start(program, application, body or nothing, key)
        response.headers["Location"] = f"/operations/{operation.id}"
        wait_s = preferred_wait_s(request.headers.getlist("prefer"))
        if wait_s is not None:
            with suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await operation.wait()
            response.headers["Preference-Applied"] = f"wait={wait_s}"
            response.status_code = HTTPStatus.OK if operation.state.ended else HTTPStatus.ACCEPTED
        return operation

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


def add_resources(app: FastAPI, operations: Operations) -> None:
    """Adds reading and cancelling operations to ``app``."""

    async def found(operation_id: str) -> Operation:
        return operations.get(operation_id)

    Found = Annotated[Operation, Depends(found)]

    @app.get("/operations", tags=["operations"], summary="All operations, oldest first")
    async def every() -> list[Operation]:
        return operations.list()

    @app.get("/operations/{operation_id}", tags=["operations"], summary="One operation")
    async def one(operation: Found) -> Operation:
        return operation

    @app.post("/operations/{operation_id}/cancel", tags=["operations"], summary="End it and stop the arm")
    async def cancel(operation: Found) -> Operation:
        """409 when it has already ended."""
        return await operations.cancel(operation.id)
