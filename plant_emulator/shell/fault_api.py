"""The emulator's HTTP API, in a process of its own: see what is broken, break it, mend it, begin anew.

Everyone may read; where the arm really is only with ``shows_truth``. Changing is refused unless the emulator
was started with ``--allow-faults``. Errors are problem documents (RFC 9457) with a ``cause``. Started by
``fault_desk`` with its configuration as JSON on stdin and two inherited sockets; it ends when the plant's end
of the link closes. What it is asked is judged here; the plant sees orders that fit the schema, one at a time.
"""

import asyncio
import contextlib
import itertools
import signal
import socket
import sys
from collections.abc import Sequence
from http import HTTPStatus
from typing import Any, Protocol, cast

import uvloop
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.middleware.cors import CORSMiddleware
from fastapi.responses import JSONResponse
from starlette.middleware.base import RequestResponseEndpoint

from foundation.event_log import EventLog, process_log
from foundation.periods import Policy, take_policy
from foundation.rest.files import add_docs
from foundation.rest.problems import problem
from foundation.rest.server import RestServer, door, install_problems, respond, service_socket
from foundation.rest.tokens import configured_access
from plant_emulator.config.service import FaultApiConfig
from plant_emulator.core.faults.kinds import FAULTS
from plant_emulator.core.faults.schedule import (
    MOST_BYTES,
    FaultOrder,
    FaultState,
    MendOrder,
    Order,
    OrderAnswer,
    OrderMessage,
    PlantMessage,
    RestartOrder,
)
from protocol.errors import LinkLost, RequestRefused

READY = b"ready"  # the first message to the plant
_ANSWER_WITHIN_S = 2.0
_SHOWN = 80  # characters of a value that is refused
_STATUS_OF_CAUSE = {
    "refused.faults_not_allowed": HTTPStatus.FORBIDDEN,
    "refused.no_such_fault": HTTPStatus.NOT_FOUND,
    "refused.truth_hidden": HTTPStatus.NOT_FOUND,
    "refused.unknown_fault": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.disturbance": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.fault_parameter": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.unknown_marker": HTTPStatus.UNPROCESSABLE_ENTITY,
    "link.plant_silent": HTTPStatus.SERVICE_UNAVAILABLE,
}


class FaultedPlant(Protocol):
    """The plant as the API sees it."""

    async def state(self) -> FaultState:
        """The newest state that the plant has told."""
        ...

    async def arm_points_m(self) -> list[list[float]] | None:
        """Where the arm really is by the newest that the plant has told; None where it does not tell."""
        ...

    async def ask(self, order: Order) -> list[dict[str, Any]]:
        """The faults that an order made or mended. Raises RequestRefused."""
        ...


class DeskLink:
    """The API's end of the link to the plant: one order under way, the others wait."""

    def __init__(self, link: socket.socket) -> None:
        self.ended = asyncio.Event()
        self._link = link
        self._numbers = itertools.count(1)
        self._one = asyncio.Lock()
        self._told = asyncio.Event()
        self._newest: PlantMessage | None = None
        self._waiting: asyncio.Future[OrderAnswer] | None = None
        link.setblocking(False)
        asyncio.get_running_loop().add_reader(link.fileno(), self._arrived)

    async def state(self) -> FaultState:
        """The newest state that the plant has told. Raises LinkLost when it tells none."""
        return (await self._told_last()).state

    async def arm_points_m(self) -> list[list[float]] | None:
        """Where the arm really is, None where that is not shown. Raises LinkLost when nothing is told."""
        return (await self._told_last()).arm_points_m

    async def _told_last(self) -> PlantMessage:
        async with _patience():
            await self._told.wait()
        assert self._newest is not None
        return self._newest

    async def ask(self, order: Order) -> list[dict[str, Any]]:
        """The faults that an order made or mended. Raises RequestRefused; LinkLost without an answer."""
        async with self._one, _patience():
            self._waiting = asyncio.get_running_loop().create_future()
            message = OrderMessage(number=next(self._numbers), order=order)
            self._link.send(message.model_dump_json().encode())
            answer = await self._waiting
            while answer.number != message.number:  # one that came too late for its own order
                self._waiting = asyncio.get_running_loop().create_future()
                answer = await self._waiting
        if answer.cause:
            raise RequestRefused(answer.cause, answer.detail)
        return list(answer.concerned)

    def _arrived(self) -> None:
        try:
            data = self._link.recv(MOST_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            asyncio.get_running_loop().remove_reader(self._link.fileno())
            self.ended.set()
            return
        message = PlantMessage.model_validate_json(data)
        self._newest = message
        self._told.set()
        if message.answer is not None and self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(message.answer)


@contextlib.asynccontextmanager
async def _patience() -> Any:
    try:
        async with asyncio.timeout(_ANSWER_WITHIN_S):
            yield
    except TimeoutError as error:
        raise LinkLost(
            "link.plant_silent", f"the plant has not answered for {_ANSWER_WITHIN_S:g} s"
        ) from error


def create_app(plant: FaultedPlant, allowed: bool, origins: Sequence[str] = ()) -> FastAPI:
    """The application over one plant. Pages of ``origins`` may read its answers."""
    app = FastAPI(title="Longreach plant emulator", version="1", docs_url=None, redoc_url=None)
    if origins:
        app.add_middleware(CORSMiddleware, allow_origins=origins, allow_methods=["GET", "POST"])
    install_problems(app, _STATUS_OF_CAUSE, _problem_of)

    @app.middleware("http")
    async def refuse_changes(request: Request, go_on: RequestResponseEndpoint) -> Response:
        if allowed or request.method in ("GET", "HEAD"):
            return await go_on(request)
        cause, why = "refused.faults_not_allowed", "this emulator was started without --allow-faults"
        return respond(problem(_STATUS_OF_CAUSE[cause], cause, why, instance=request.url.path))

    add_docs(app)
    _add_reading(app, plant, allowed)
    _add_changing(app, plant)
    return app


def _add_reading(app: FastAPI, plant: FaultedPlant, allowed: bool) -> None:
    told = JSONResponse(
        [
            {"kind": kind, "description": model.__doc__, "schema": model.model_json_schema()}
            for kind, model in FAULTS.items()
        ]
    ).body

    @app.get("/faults/kinds", response_model=list[dict[str, Any]])
    async def kinds() -> Response:
        """Every kind of fault: what it does, and the JSON schema of its parameters."""
        return Response(told, media_type="application/json")

    @app.get("/faults")
    async def faults() -> dict[str, Any]:
        """The simulated time, and what is in force and planned; at most 50 ms old."""
        state = await plant.state()
        return {"allowed": allowed, **state.model_dump()}

    @app.get("/truth")
    async def truth() -> dict[str, Any]:
        """Where the arm really is: points in its base from the base over joints and hinges to the tool, m.

        At most 50 ms old. For people who compare; nothing that controls the arm may read it.
        """
        points = await plant.arm_points_m()
        if points is None:
            raise RequestRefused("refused.truth_hidden", "this emulator was started without --show-truth")
        return {"time_ns": (await plant.state()).time_ns, "arm_points_m": points}

    @app.get("/faults/{number}")
    async def fault(number: int) -> dict[str, Any]:
        """One fault in force or planned."""
        state = await plant.state()
        for injection in (*state.active, *state.planned):
            if injection["number"] == number:
                return injection
        raise RequestRefused("refused.no_such_fault", f"number {number}: neither in force nor planned")


def _add_changing(app: FastAPI, plant: FaultedPlant) -> None:
    @app.post("/faults", status_code=HTTPStatus.CREATED)
    async def inject(order: FaultOrder, response: Response) -> dict[str, Any]:
        """Break something, now or later; the answer names its number."""
        (injection,) = await plant.ask(order)
        response.headers["location"] = f"/faults/{injection['number']}"
        return injection

    @app.delete("/faults/{number}")
    async def clear(number: int) -> dict[str, Any]:
        """Mend one fault, or withdraw it before it begins."""
        (injection,) = await plant.ask(MendOrder(number=number))
        return injection

    @app.delete("/faults")
    async def clear_all() -> list[dict[str, Any]]:
        """Mend everything; what was mended and withdrawn."""
        return await plant.ask(MendOrder(number=None))

    @app.post("/world/restart", status_code=HTTPStatus.ACCEPTED)
    async def restart() -> dict[str, bool]:
        """End the emulator; ``longreach up`` starts it anew, with the world as it was at first."""
        await plant.ask(RestartOrder())
        return {"restarts": True}


def _problem_of(error: RequestValidationError) -> dict[str, Any]:
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


async def serve(config: FaultApiConfig, listener: socket.socket, link: socket.socket, log: EventLog) -> None:
    """Serve until the plant's end of ``link`` closes."""
    plant = DeskLink(link)
    app = create_app(plant, config.allowed, config.allowed_origins)
    origins = frozenset(origin.lower() for origin in config.allowed_origins)
    access = configured_access(config, "plant_service.fault_face")._replace(allowed_origins=origins)
    with service_socket() as (at, behind):
        server = RestServer(app)
        serving = asyncio.create_task(server.serve([behind]))
        async with door(listener, at, access, log):
            link.send(READY)
            await plant.ended.wait()
        server.should_exit = server.force_exit = True  # without a plant nothing under way can be answered
        await serving


def main() -> int:
    """Exit status of the API's process."""
    # A signal to the whole process group reaches the plant too, which then closes its end of the link.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    listen_fd, link_fd, scheduling = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    with (
        process_log("fault_api") as log,
        socket.socket(fileno=listen_fd) as listener,
        socket.socket(fileno=link_fd) as link,
        asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner,
    ):
        config = FaultApiConfig.model_validate_json(sys.stdin.buffer.read())
        take_policy(cast(Policy, scheduling))
        runner.run(serve(config, listener, link, log))
    return 0


if __name__ == "__main__":
    sys.exit(main())
