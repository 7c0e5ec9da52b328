"""Routes of the operation resources: starting each kind, reading, cancelling, and following as events."""

from collections.abc import AsyncIterable, Callable
from http import HTTPStatus
from typing import Annotated

from fastapi import Depends, FastAPI, Header, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent
from fastapi.types import DecoratedCallable
from pydantic import BaseModel

from foundation.configuration import ModelT, validated
from vision_pc.application.operations import Operation, Operations, Program
from vision_pc.application.schemas import (
    JSON,
    Body,
    LineEquationBody,
    LocalTrackBody,
    LookBody,
    LookingAndMovingBody,
    LookThenMoveBody,
    MoveBody,
    OperationView,
    OrientationBody,
    TrajectoryBody,
    operation_view,
)
from vision_pc.application.station import Station
from vision_pc.core.ports import Report

Key = Annotated[
    str | None,
    Header(alias="Idempotency-Key", min_length=1, max_length=100, description="Same key, same operation"),
]


class OperationRoutes:
    """Starts operations: idempotency first, then the present state, then one at a time."""

    def __init__(self, station: Station, operations: Operations) -> None:
        self.station = station
        self.operations = operations

    def start(
        self,
        kind: str,
        body: Body,
        program: Program,
        key: str | None,
        response: Response,
        method: str | None = None,
    ) -> OperationView:
        """The resource of a new (or, by its key, the earlier) operation."""
        request: JSON = body.model_dump(mode="json", exclude_none=True)
        operation = self.operations.repeated(kind, request, key)
        if operation is None:
            self.station.refuse_now(kind, method)
            operation = self.operations.start(kind, request, program, key)
        response.headers["Location"] = f"/operations/{operation.id}"
        return operation_view(operation)


def with_overrides(settings: ModelT, body: Body) -> ModelT:
    """``settings`` with what the request gave laid over them.

    Raises ConfigurationError (a 422 problem) when the combination is out of range.
    """
    return validated(type(settings), settings.model_dump() | body.overrides(), "request")


def add_operations(app: FastAPI, station: Station, operations: Operations) -> None:
    """Adds all operation routes to ``app``."""
    routes = OperationRoutes(station, operations)
    _add_looking(app, routes)
    _add_moving(app, routes)
    _add_resources(app, operations)


def _post(app: FastAPI, kind: str, summary: str) -> Callable[[DecoratedCallable], DecoratedCallable]:
    return app.post(
        f"/operations/{kind}",
        tags=["operations"],
        summary=summary,
        status_code=HTTPStatus.ACCEPTED,
        operation_id=kind.replace("-", "_"),
        responses={202: {"headers": {"Location": {"schema": {"type": "string"}}}}},
    )


def _add_looking(app: FastAPI, routes: OperationRoutes) -> None:
    station = routes.station

    @_post(app, "look", "Look at tool and object with the arm at rest")
    async def look(response: Response, body: LookBody | None = None, key: Key = None) -> OperationView:
        asked = body or LookBody()

        async def program(report: Report) -> JSON:
            return await station.look(asked.frames, report)

        return routes.start("look", asked, program, key, response)

    @_post(app, "orientation-adjustment", "Turn the tool parallel to the object (7)(8)")
    async def orientation(
        response: Response, body: OrientationBody | None = None, key: Key = None
    ) -> OperationView:
        asked = body or OrientationBody()
        settings = with_overrides(station.settings.orientation, asked)

        async def program(report: Report) -> JSON:
            return await station.adjust_orientation(settings, report)

        return routes.start("orientation-adjustment", asked, program, key, response)

    @_post(app, "line-equation", "Circle, line equation, one input (10)-(16)")
    async def line(
        response: Response, body: LineEquationBody | None = None, key: Key = None
    ) -> OperationView:
        asked = body or LineEquationBody()
        settings = with_overrides(station.settings.line_equation, asked)

        async def program(report: Report) -> JSON:
            return await station.line_equation(settings, report)

        return routes.start("line-equation", asked, program, key, response)

    @_post(app, "trajectory-matching", "Local calibration by trajectory matching (17)-(19)")
    async def trajectory(
        response: Response, body: TrajectoryBody | None = None, key: Key = None
    ) -> OperationView:
        asked = body or TrajectoryBody()
        settings = with_overrides(station.settings.trajectory, asked)

        async def program(report: Report) -> JSON:
            return await station.trajectory_matching(settings, report)

        return routes.start("trajectory-matching", asked, program, key, response)

    @_post(app, "local-track", "Three legs for the corrected look-then-move")
    async def track(response: Response, body: LocalTrackBody | None = None, key: Key = None) -> OperationView:
        asked = body or LocalTrackBody()
        settings = with_overrides(station.settings.local_map, asked)

        async def program(report: Report) -> JSON:
            return await station.local_track(settings, report)

        return routes.start("local-track", asked, program, key, response)


def _add_moving(app: FastAPI, routes: OperationRoutes) -> None:
    station = routes.station

    @_post(app, "look-then-move", "Look, then move the tool to the object (20)-(22)")
    async def look_then_move(
        response: Response, body: LookThenMoveBody | None = None, key: Key = None
    ) -> OperationView:
        asked = body or LookThenMoveBody()
        settings = with_overrides(station.settings.positioning, asked)

        async def program(report: Report) -> JSON:
            return await station.look_then_move(settings, asked.method, report)

        return routes.start("look-then-move", asked, program, key, response, asked.method)

    @_post(app, "looking-and-moving", "Drive the tool to the object in closed loop, at camera rate")
    async def looking_and_moving(
        response: Response, body: LookingAndMovingBody | None = None, key: Key = None
    ) -> OperationView:
        asked = body or LookingAndMovingBody()
        settings = with_overrides(station.settings.looking_and_moving, asked)
        usual = station.settings.positioning.clearance_m
        clearance_m = usual if asked.clearance_m is None else asked.clearance_m

        async def program(report: Report) -> JSON:
            return await station.looking_and_moving(settings, clearance_m, report)

        return routes.start("looking-and-moving", asked, program, key, response)

    @_post(app, "move", "Move the tool point to point")
    async def move(response: Response, body: MoveBody, key: Key = None) -> OperationView:
        async def program(report: Report) -> JSON:
            return await station.move(body, report)

        return routes.start("move", body, program, key, response)


class ProgressEvent(BaseModel):
    """Data of a ``progress`` event."""

    progress: float
    note: str


def _add_resources(app: FastAPI, operations: Operations) -> None:
    def found(operation_id: str) -> Operation:
        return operations.get(operation_id)

    Found = Annotated[Operation, Depends(found)]

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
             response_class=EventSourceResponse)  # fmt: skip
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
