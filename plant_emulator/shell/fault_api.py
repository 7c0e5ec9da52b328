"""The emulator's HTTP face for faults: what can break, what is broken, break it, mend it.

Everyone may read. Breaking and mending is refused unless the emulator was started with ``--allow-faults``.
Errors are problem documents (RFC 9457) with a machine-readable ``cause``.
"""

import asyncio
import socket
from http import HTTPStatus
from typing import Annotated, Any

from fastapi import FastAPI, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import Field
from starlette.types import Scope

from foundation.configuration import StrictModel
from foundation.event_log import EventLog
from foundation.problems import problem
from foundation.rest.access import configured_access
from foundation.rest.refusals import Refusal
from foundation.rest.server import RestServer, install_problems
from plant_emulator.config.service import FaultApiConfig
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.faults.kinds import FAULTS, Fault, MarkerCovered
from plant_emulator.core.faults.schedule import Injection
from plant_emulator.core.plant import Plant
from protocol.errors import RequestRefused

LONGEST_S = 3600.0
_SHOWN = 80  # characters of a value that is refused
_STATUS_OF_CAUSE = {
    "refused.faults_not_allowed": HTTPStatus.FORBIDDEN,
    "refused.no_such_fault": HTTPStatus.NOT_FOUND,
    "refused.unknown_fault": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.fault_parameter": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.unknown_marker": HTTPStatus.UNPROCESSABLE_ENTITY,
}


class FaultOrder(StrictModel):
    """A fault, ``start_after_s`` of simulated time from now, for ``duration_s`` (null: until cleared)."""

    fault: Annotated[Fault, Field(discriminator="kind")]
    start_after_s: Annotated[float, Field(ge=0.0, le=LONGEST_S)] = 0.0
    duration_s: Annotated[float, Field(gt=0.0, le=LONGEST_S)] | None = None


class FaultFace:
    """The face, served in the running event loop, which is the plant's own."""

    def __init__(self, plant: Plant, scene: Scene, config: FaultApiConfig, log: EventLog) -> None:
        app = create_app(plant, scene, config.allowed)
        self._server = RestServer(app, configured_access(config, "plant_service.fault_face"), log)
        self._serving: asyncio.Task[None] | None = None

    def start(self, listener: socket.socket) -> None:
        """Serve at ``listener``."""
        self._serving = asyncio.get_running_loop().create_task(self._server.serve([listener]))

    async def stop(self) -> None:
        """Stop serving."""
        if self._serving is not None:
            self._server.should_exit = True
            await self._serving


def create_app(plant: Plant, scene: Scene, allowed: bool) -> FastAPI:
    """The application over one running plant; it must be served in the plant's own event loop."""
    app = FastAPI(title="Longreach plant emulator: faults", version="1")
    install_problems(app, _STATUS_OF_CAUSE, _explained, None if allowed else _not_allowed)
    _add_reading(app, plant, allowed)
    _add_changing(app, plant, scene)
    return app


def _add_reading(app: FastAPI, plant: Plant, allowed: bool) -> None:
    every_kind = JSONResponse(
        [
            {"kind": kind, "description": model.__doc__, "schema": model.model_json_schema()}
            for kind, model in FAULTS.items()
        ]
    ).body  # made once: this loop has the fieldbus to serve

    @app.get("/faults/kinds", response_model=list[dict[str, Any]])
    async def kinds() -> Response:
        """Every kind of fault: what it does, and the JSON schema of its parameters."""
        return Response(every_kind, media_type="application/json")

    @app.get("/faults")
    async def faults() -> dict[str, Any]:
        """The simulated time, and what is in force and planned."""
        return {
            "allowed": allowed,
            "time_ns": plant.time_ns,
            "active": [injection.as_dict() for injection in plant.faults.active],
            "planned": [injection.as_dict() for injection in plant.faults.planned],
        }

    @app.get("/faults/{number}")
    async def fault(number: int) -> dict[str, Any]:
        """One fault in force or planned."""
        return _known(plant, number).as_dict()


def _add_changing(app: FastAPI, plant: Plant, scene: Scene) -> None:
    @app.post("/faults", status_code=HTTPStatus.CREATED)
    async def inject(order: FaultOrder, response: Response) -> dict[str, Any]:
        """Break something, now or later; the answer names its number."""
        if isinstance(order.fault, MarkerCovered):
            scene.cover(order.fault)
        start_ns = plant.time_ns + round(1e9 * order.start_after_s)
        duration_ns = None if order.duration_s is None else max(round(1e9 * order.duration_s), 1)
        injection = plant.inject(order.fault, start_ns, duration_ns)
        response.headers["location"] = f"/faults/{injection.number}"
        return injection.as_dict()

    @app.delete("/faults/{number}")
    async def clear(number: int) -> dict[str, Any]:
        """Mend one fault, or withdraw it before it begins."""
        return plant.clear(number).as_dict()

    @app.delete("/faults")
    async def clear_all() -> list[dict[str, Any]]:
        """Mend everything; what was mended and withdrawn."""
        cleared = [injection.as_dict() for injection in plant.faults.all()]
        plant.clear_faults()
        return cleared


def _not_allowed(scope: Scope) -> Refusal | None:
    """The problem of a request that would change anything, before its body is read."""
    if scope["method"] in ("GET", "HEAD"):
        return None
    cause, why = "refused.faults_not_allowed", "this emulator was started without --allow-faults"
    return problem(_STATUS_OF_CAUSE[cause], cause, why, instance=scope["path"])


def _known(plant: Plant, number: int) -> Injection:
    for injection in plant.faults.all():
        if injection.number == number:
            return injection
    raise RequestRefused("refused.no_such_fault", f"number {number}: neither in force nor planned")


def _explained(error: RequestValidationError) -> dict[str, Any]:
    """The problem of an order that fits no schema; it says which value, and whether of a fault's own."""
    first = error.errors()[0]
    place = [str(part) for part in first["loc"]]
    cause = "request.invalid"
    if place[:2] == ["body", "fault"] and len(place) > 2:
        cause = "refused.fault_parameter"
    elif first["type"].startswith("union_tag"):
        cause = "refused.unknown_fault"
    value = "" if first["type"] == "missing" else f" = {first['input']!r}"[:_SHOWN]
    detail = f"{'.'.join(place)}{value}: {first['msg']}"
    return problem(HTTPStatus.UNPROCESSABLE_ENTITY, cause, detail)
