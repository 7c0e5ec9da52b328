"""The REST API: state, looks, commands, and every long step as an operation resource."""

import asyncio
import json
import time
from collections.abc import Awaitable, Callable, Collection, Sequence
from functools import partial
from importlib.resources import files
from typing import Any

from fastapi import Depends, FastAPI, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field

from foundation.numbers_as_written import written_number
from foundation.rest.files import add_docs
from foundation.rest.problems import MEDIA_TYPE, problem
from foundation.rest.server import install_problems, respond
from protocol.errors import RequestRefused
from protocol.faults import CommandCode, GroupState, Reason, refusal
from vision_pc.application.application import VisionApplication
from vision_pc.application.console.advice import advice
from vision_pc.application.console.overview import Overview, lasting
from vision_pc.application.program import Program, by_name
from vision_pc.application.programs import PROGRAMS
from vision_pc.application.results import JSON, calibration_json, doubt_json, look_json, seen_json
from vision_pc.shell.machine_clock import MachineClock
from vision_pc.shell.rest.clock_routes import add_clock, clock_json, stands_words, while_requested
from vision_pc.shell.rest.console.routes import Console, add_console
from vision_pc.shell.rest.hand_eye_routes import add_session
from vision_pc.shell.rest.metrics import add_metrics
from vision_pc.shell.rest.operation_routes import add_programs, add_resources, add_unknown
from vision_pc.shell.rest.operations import STATUS_OF_CAUSE, Operations
from vision_pc.shell.rest.state_view import LinkView, link_view, state_json
from vision_pc.shell.rest.target_routes import add_targets

DOCUMENT = files("vision_pc.shell.rest") / "openapi.json"
SHOWN = "longreach-shown"
MOST_S = 5.0  # a busy machine has answered within 2 s
_JUDGED = frozenset({"POST", "PUT", "PATCH"})  # DELETE forgets, whenever it comes


def while_recent(stops: Collection[str]) -> Callable[[Request], Awaitable[None]]:
    """A dependency that raises RequestRefused for a request that its header ``Longreach-Shown`` dates back.

    The header is the ``time`` (s) of the snapshot that the console showed, on this machine's own clock.
    Causes: ``refused.asked_too_late`` after ``MOST_S``, ``request.bad_header`` for what is no time. Who sends
    none is not judged, nor are the paths ``stops`` and the end of an operation.
    """

    async def judge(request: Request) -> None:
        shown, path = request.headers.get(SHOWN), request.url.path
        if shown is None or request.method not in _JUDGED or path in stops or path.endswith("/cancel"):
            return
        try:
            age_s = time.time() - written_number(shown)
        except ValueError as error:
            why = f"Longreach-Shown: {error}; wanted the snapshot's time, in seconds"
            raise RequestRefused("request.bad_header", why) from error
        if abs(age_s) > MOST_S:
            why = f"asked of what was shown {age_s:.1f} s ago, at most {MOST_S:g} s: nothing was done"
            raise RequestRefused("refused.asked_too_late", why)

    return judge


STOPS = ("/stop", "/disable", "/emergency-stop")  # whoever may look may stop
DESCRIPTION = """
Drives the tool to the object: orientation adjustment, local calibration by motion, look-then-move.

Every long step is `202` with an operation resource (`Location`). Errors are RFC 9457 problem documents with a
machine-readable `cause`, and `advice` what to do. Nothing moves before `POST /enable`; `POST /stop` is always
accepted.

Where tokens are configured, every request carries one: `Authorization: Bearer TOKEN`, or Basic with the token
as password. The role `look` may GET and stop, `operate` may do everything. Otherwise: 401 `refused.no_token`
or `refused.wrong_token`, 403 `refused.role`.
"""
_EXAMPLE = problem(409, "refused.disabled", "move: the arm is disabled; enable first",
                   advice=advice("refused.disabled"))  # fmt: skip
_PROBLEM: JSON = {"description": "A problem", "content": {MEDIA_TYPE: {"example": _EXAMPLE}}}


def create_app(
    application: VisionApplication,
    operations: Operations,
    programs: Sequence[Program[Any, Any]] = PROGRAMS,
    emulator_face: str = "",
    machine: MachineClock | None = None,
) -> FastAPI:
    """The API over one application.

    ``emulator_face``: an address that the console may ask for what no service knows; ``machine``: its clock.
    Raises ConfigurationError when two programs have one name.
    """
    machine = machine or MachineClock()
    app = FastAPI(
        title="Longreach vision PC",
        version="1",
        description=DESCRIPTION,
        responses={"4XX": _PROBLEM, "5XX": _PROBLEM},
        dependencies=[Depends(while_recent(STOPS)), Depends(while_requested(machine, STOPS))],
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
    )
    install_problems(app, STATUS_OF_CAUSE, advise=advice)
    add_docs(app)
    titles = {program.name: program.title for program in programs}
    seen = Overview(application.links), titles, partial(clock_json, machine)
    add_console(app, Console(application, operations, *seen), emulator_face)
    _add_state(app, application, operations, machine)
    add_clock(app, machine)
    add_metrics(app, application)
    _add_looks(app, application)
    _add_commands(app, application, operations)
    add_targets(app, application, operations)
    table = tuple(by_name(programs).values())
    _add_table(app, table)
    add_programs(app, application, operations, table)
    add_resources(app, operations)
    add_session(app, operations, application)
    _add_document(app, programs is PROGRAMS)
    add_unknown(app, [program.name for program in table])
    return app


def _add_document(app: FastAPI, whole: bool) -> None:
    """Adds ``/openapi.json``. What is ``whole`` was made at build; else a thread makes it, once."""
    made = [DOCUMENT.read_bytes()] if whole else []

    @app.get("/openapi.json", include_in_schema=False)
    async def document() -> Response:
        if not made:
            made.append(await asyncio.to_thread(lambda: json.dumps(app.openapi()).encode()))
        return Response(made[0], media_type="application/json")


def _add_state(
    app: FastAPI, application: VisionApplication, operations: Operations, machine: MachineClock
) -> None:
    @app.get("/health", tags=["state"], summary="Whether controller, plant and camera answer")
    async def health(request: Request) -> Response:
        """200 when all answer, else a 503 problem that says which has crashed, and which does not answer."""
        controller, camera = application.controller, application.camera.status()
        parts = {
            "controller": controller.connected,
            "camera": camera.connected,
            "recording": application.log.healthy,
        }
        why = [incident.detail for incident in lasting(application)] + stands_words(machine)
        if controller.connected and not controller.hears_plant:
            why.append("the controller does not hear the plant")
        if not why and all(parts.values()):
            return JSONResponse({"status": "ok"} | parts)
        if missing := ", ".join(name for name, answers in parts.items() if not answers):
            why.append(f"not answering: {missing}")
        if trouble := link_view(controller).trouble:
            why.append(f"{trouble.cause}: {trouble.detail}")
        if camera.trouble is not None:
            why.append(camera.trouble + (f": {camera.detail}" if camera.detail else ""))
        return respond(problem(503, "link.degraded", "; ".join(why), instance=request.url.path) | parts)

    @app.get("/state", tags=["state"], summary="The arm as the controller sees it, links and operation")
    async def state() -> JSON:
        """Group state, fault, joints, poses, timing, links, and what has been calibrated."""
        return state_json(application) | {
            "incidents": [incident._asdict() for incident in application.incidents()],
            "clock": clock_json(machine),
            "operation": operations.current.id if operations.current else None,
            "calibration": application.calibration and calibration_json(application.calibration),
            "doubt": doubt_json(application.doubts.doubt),
        }

    @app.get("/link", tags=["state"], summary="The reference link in numbers, on both sides")
    async def link() -> LinkView:
        """Always answered: session, authentication, every counter of datagrams, and the clock's offset."""
        return link_view(application.controller)


class ProgramView(BaseModel):
    """A program that can be asked for at ``/operations/NAME``."""

    name: str
    title: str
    own: bool = Field(description="one of your own, not of Longreach")


def _add_table(app: FastAPI, table: Sequence[Program[Any, Any]]) -> None:
    ours = {program.name for program in PROGRAMS}
    views = [ProgramView(name=one.name, title=one.title, own=one.name not in ours) for one in table]

    @app.get("/programs", tags=["operations"], summary="Every program")
    async def programs() -> list[ProgramView]:
        return views


def _add_looks(app: FastAPI, application: VisionApplication) -> None:
    @app.get("/looks/latest", tags=["looks"], summary="The latest look, with error, uncertainty and verdict")
    async def latest_look() -> JSON:
        """404 until something was looked at."""
        return look_json(application.latest_look)

    @app.delete("/doubt", tags=["looks"], summary="End the doubt: a person knows that nothing moves")
    async def end_doubt() -> JSON:
        """Answers with the doubt that has ended, null where there was none."""
        before = application.doubts.doubt
        application.trust("person")
        return {"doubt": doubt_json(before)}

    @app.get("/camera/markers", tags=["looks"], summary="The markers in the newest picture")
    async def markers() -> JSON:
        """Markers, tool and object, with or without a controller; nothing is averaged."""
        await application.camera.observe()
        connected = application.controller.connected
        return seen_json(application.camera.seen()) | {
            "controller": "connected" if connected else "not connected"
        }

    @app.get("/camera/latest.png", tags=["looks"], summary="The newest picture with detections drawn in",
             response_class=Response, responses={200: {"content": {"image/png": {}}}})  # fmt: skip
    async def latest_picture() -> Response:
        """The left eye's newest picture."""
        return Response(
            await application.camera.latest_png(),
            media_type="image/png",
            headers={"Cache-Control": "no-store"},
        )


def _add_commands(app: FastAPI, application: VisionApplication, operations: Operations) -> None:
    async def commanded(code: CommandCode) -> JSON:
        answer = await application.controller.command(code)
        state = await application.controller.next_state()
        if code is CommandCode.ENABLE and state.group_state is GroupState.ERROR_STOP:  # it broke down at once
            why = f"by {state.fault.name.lower().replace('_', ' ')}"
            raise refusal("enable", Reason.ERROR_LATCHED, 0.0, 0.0, why)
        return {"accepted": True, "reason": answer.reason.name.lower()} | state_json(application)

    async def ending(code: CommandCode) -> JSON:
        """The command first, then the end of the running operation, answered or not.

        The door answers the same (``vision_pc.shell.stops``), where it can send the stop itself.
        """
        try:
            return await commanded(code)
        finally:
            await operations.close()

    def add(path: str, code: CommandCode, act: Callable[[CommandCode], Awaitable[JSON]], what: str) -> None:
        async def endpoint() -> JSON:
            return await act(code)

        name = path.strip("/").replace("-", "_")
        app.post(path, tags=["commands"], name=name, operation_id=name, summary=what)(endpoint)

    add("/enable", CommandCode.ENABLE, commanded, "Enable the arm: without it nothing moves")
    add("/disable", CommandCode.DISABLE, ending, "Stop, end the running operation, disable")
    add("/stop", CommandCode.STOP, ending, "Stop and end the running operation; always accepted")
    add("/reset", CommandCode.RESET, commanded, "Clear a latched fault")
    add("/emergency-stop", CommandCode.EMERGENCY_STOP, ending, "Latch the emergency stop")
    add("/emergency-release", CommandCode.EMERGENCY_RELEASE, commanded, "Release it; a reset must follow")
