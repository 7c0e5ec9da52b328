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
from typing import Any

import uvloop
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.middleware.cors import CORSMiddleware
from fastapi.responses import JSONResponse
from starlette.middleware.base import RequestResponseEndpoint

from foundation.configuration import fault_words
from foundation.event_log import EventLog, process_log
from foundation.rest.files import add_docs
from foundation.rest.problems import problem
from foundation.rest.server import RestServer, door, install_problems, respond, service_socket
from foundation.rest.tokens import configured_access
from plant_emulator.config.service import FaultApiConfig
from plant_emulator.core.faults.kinds import FAULTS
from plant_emulator.core.faults.schedule import (
    MOST_BYTES,
    FaultOrder,
    LookOrder,
    MendOrder,
    Order,
    OrderMessage,
    PlantAnswer,
    RestartOrder,
)
from protocol.errors import LinkLost, RequestRefused

READY = b"ready"  # the first message to the plant
_ANSWER_WITHIN_S = 2.0
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


class DeskLink:
    """The API's end of the link to the plant: one order under way, the others wait."""

    def __init__(self, link: socket.socket) -> None:
        self.ended = asyncio.Event()
        self._link = link
        self._numbers = itertools.count(1)
        self._one = asyncio.Lock()
        self._answers: asyncio.Queue[PlantAnswer] = asyncio.Queue()
        link.setblocking(False)
        self._listening = asyncio.create_task(self._listen())

    async def ask(self, order: Order) -> PlantAnswer:
        """What became of an order. Raises RequestRefused; LinkLost without an answer."""
        message = OrderMessage(number=next(self._numbers), order=order)
        try:
            async with self._one, asyncio.timeout(_ANSWER_WITHIN_S):
                self._link.send(message.model_dump_json().encode())
                while (answer := await self._answers.get()).number != message.number:
                    pass  # it came too late for its own order
        except TimeoutError as error:
            why = f"the plant has not answered for {_ANSWER_WITHIN_S:g} s"
            raise LinkLost("link.plant_silent", why) from error
        if answer.cause:
            raise RequestRefused(answer.cause, answer.detail)
        return answer

    async def _listen(self) -> None:
        with contextlib.suppress(OSError):
            while data := await asyncio.get_running_loop().sock_recv(self._link, MOST_BYTES):
                self._answers.put_nowait(PlantAnswer.model_validate_json(data))
        self.ended.set()


def create_app(plant: DeskLink, allowed: bool, origins: Sequence[str] = ()) -> FastAPI:
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


def _add_reading(app: FastAPI, plant: DeskLink, allowed: bool) -> None:
    answer = JSONResponse(
        [
            {"kind": kind, "description": model.__doc__, "schema": model.model_json_schema()}
            for kind, model in FAULTS.items()
        ]
    ).body

    @app.get("/faults/kinds", response_model=list[dict[str, Any]])
    async def kinds() -> Response:
        """Every kind of fault: what it does, and the JSON schema of its parameters."""
        return Response(answer, media_type="application/json")

    @app.get("/faults")
    async def faults() -> dict[str, Any]:
        """The simulated time, and what is in force and planned."""
        state = (await plant.ask(LookOrder())).model_dump(include={"time_ns", "active", "planned"})
        return {"allowed": allowed, **state}

    @app.get("/truth")
    async def truth() -> dict[str, Any]:
        """Where the arm really is: points in its base from the base over joints and hinges to the tool, m.

        For people who compare; nothing that controls the arm may read it.
        """
        answer = await plant.ask(LookOrder())
        if answer.arm_points_m is None:
            raise RequestRefused("refused.truth_hidden", "this emulator was started without --show-truth")
        return {"time_ns": answer.time_ns, "arm_points_m": answer.arm_points_m}

    @app.get("/faults/{number}")
    async def fault(number: int) -> dict[str, Any]:
        """One fault in force or planned."""
        state = await plant.ask(LookOrder())
        for injection in (*state.active, *state.planned):
            if injection["number"] == number:
                return injection
        raise RequestRefused("refused.no_such_fault", f"number {number}: neither in force nor planned")


def _add_changing(app: FastAPI, plant: DeskLink) -> None:
    @app.post("/faults", status_code=HTTPStatus.CREATED)
    async def inject(order: FaultOrder, response: Response) -> dict[str, Any]:
        """Break something, now or later; the answer names its number."""
        (injection,) = (await plant.ask(order)).concerned
        response.headers["location"] = f"/faults/{injection['number']}"
        return injection

    @app.delete("/faults/{number}")
    async def clear(number: int) -> dict[str, Any]:
        """Mend one fault, or withdraw it before it begins."""
        (injection,) = (await plant.ask(MendOrder(number=number))).concerned
        return injection

    @app.delete("/faults")
    async def clear_all() -> list[dict[str, Any]]:
        """Mend everything; what was mended and withdrawn."""
        return (await plant.ask(MendOrder(number=None))).concerned

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
    return problem(HTTPStatus.UNPROCESSABLE_ENTITY, cause, fault_words(first))


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
    listen_fd, link_fd = int(sys.argv[1]), int(sys.argv[2])
    with (
        process_log("fault_api") as log,
        socket.socket(fileno=listen_fd) as listener,
        socket.socket(fileno=link_fd) as link,
        asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner,
    ):
        config = FaultApiConfig.model_validate_json(sys.stdin.buffer.read())
        runner.run(serve(config, listener, link, log))
    return 0


if __name__ == "__main__":
    sys.exit(main())
