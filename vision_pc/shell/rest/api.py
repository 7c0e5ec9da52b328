"""The REST API: state, looks, commands, and every long step as an operation resource."""

import math
from collections.abc import Awaitable, Callable, Sequence
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.responses import JSONResponse

from foundation.problems import MEDIA_TYPE, problem
from foundation.rest.docs_page import add_docs
from foundation.rest.home import Home, run_endpoints_at
from foundation.rest.refusals import respond
from foundation.rest.server import install_problems
from protocol.faults import CommandCode
from protocol.reference_messages import FLAG_EMERGENCY_LATCHED, FLAG_PLANT_LINK_OK, FLAG_SETTLED, State
from vision_pc.application.application import VisionApplication
from vision_pc.application.hand_eye_programs import HAND_EYE
from vision_pc.application.program import Program, by_name
from vision_pc.application.programs import PROGRAMS
from vision_pc.application.results import JSON, calibration_json, look_json, pose_json
from vision_pc.core.se3 import from_pose
from vision_pc.shell.rest.hand_eye_routes import add_session
from vision_pc.shell.rest.link_view import LinkView, link_view
from vision_pc.shell.rest.operation_routes import add_programs, add_resources
from vision_pc.shell.rest.operations import Operations
from vision_pc.shell.rest.problems import STATUS_OF_CAUSE

STOPS = ("/stop", "/disable", "/emergency-stop")  # whoever may look may stop
DESCRIPTION = """
Drives the tool to the object: orientation adjustment, local calibration by motion, look-then-move.

Every long step is `202` with an operation resource (`Location`). Errors are RFC 9457 problem documents with a
machine-readable `cause`. Nothing moves before `POST /enable`; `POST /stop` is always accepted.

Where tokens are configured, every request carries one: `Authorization: Bearer TOKEN`, or Basic with the token
as password. The role `look` may GET and stop, `operate` may do everything. Otherwise: 401 `refused.no_token`
or `refused.wrong_token`, 403 `refused.role`.
"""
_EXAMPLE = problem(409, "refused.disabled", "move: the arm is disabled; enable first")
_PROBLEM: JSON = {"description": "A problem", "content": {MEDIA_TYPE: {"example": _EXAMPLE}}}


def create_app(
    application: VisionApplication,
    operations: Operations,
    programs: Sequence[Program[Any, Any]] = PROGRAMS,
    home: Home | None = None,
) -> FastAPI:
    """The API over one application; guided hand-eye calibration is there when the application has it.

    ``home``: where the application lives, if it is served elsewhere. Raises ConfigurationError when two
    programs have one name.
    """
    app = FastAPI(
        title="Longreach vision PC",
        version="1",
        description=DESCRIPTION,
        responses={"4XX": _PROBLEM, "5XX": _PROBLEM},
        docs_url=None,
        redoc_url=None,
    )
    add_docs(app)
    install_problems(app, STATUS_OF_CAUSE)
    if home is not None:
        run_endpoints_at(app, home)
    _add_state(app, application, operations)
    _add_looks(app, application)
    _add_commands(app, application, operations)
    table = by_name(programs).values()
    add_programs(app, application, operations, (program for program in table if program.tag != HAND_EYE))
    add_resources(app, operations)
    if application.hand_eye is not None:
        add_session(app, operations, application.hand_eye)
        add_programs(app, application, operations, (program for program in table if program.tag == HAND_EYE))
    return app


def _add_state(app: FastAPI, application: VisionApplication, operations: Operations) -> None:
    @app.get("/health", tags=["state"], summary="Whether controller and camera answer")
    async def health(request: Request) -> Response:
        """200 when both answer, else a 503 problem that says which does not."""
        controller, camera = application.controller, application.camera.status()
        parts = {
            "controller": controller.connected,
            "camera": camera.connected,
            "recording": application.log.healthy,
        }
        overload = application.overload()
        if all(parts.values()):
            return JSONResponse({"status": "ok", "overload": overload or None} | parts)
        missing = ", ".join(name for name, answers in parts.items() if not answers)
        status = HTTPStatus.SERVICE_UNAVAILABLE
        trouble = link_view(controller).trouble
        why = f"; {trouble.cause}: {trouble.detail}" if trouble else ""
        detail = f"not answering: {missing}{why}" + (f"; {overload}" if overload else "")
        told = {"overload": overload or None} | parts
        return respond(problem(status, "link.degraded", detail, instance=request.url.path) | told)

    @app.get("/state", tags=["state"], summary="The arm as the controller sees it, links and operation")
    async def state() -> JSON:
        """Group state, fault, joints, poses, timing, links, and what has been calibrated."""
        return state_json(application) | {
            "overload": application.overload() or None,
            "operation": operations.current.id if operations.current else None,
            "calibration": None
            if application.calibration is None
            else calibration_json(application.calibration),
        }

    @app.get("/link", tags=["state"], summary="The reference link in numbers, on both sides")
    async def link() -> LinkView:
        """Always answered: session, authentication, every counter of datagrams, and the clock's offset."""
        return link_view(application.controller)


def _add_looks(app: FastAPI, application: VisionApplication) -> None:
    @app.get("/looks/latest", tags=["looks"], summary="The latest look, with error, uncertainty and verdict")
    async def latest_look() -> JSON:
        """404 until something was looked at."""
        return look_json(application.latest_look)

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
        await application.controller.next_state()
        return {"accepted": True, "reason": answer.reason.name.lower()} | state_json(application)

    async def ending(code: CommandCode) -> JSON:
        """The command first, then the end of the running operation, answered or not."""
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


def state_json(application: VisionApplication) -> JSON:
    """The controller's newest state, the links and the camera. Raises LinkLost without a controller."""
    state = application.controller.state
    clock = application.controller.clock_offset
    camera = application.camera.status()
    return _arm_json(state) | {
        "link": {
            "age_ms": round(application.controller.state_age_ns / 1e6, 3),
            "clock_offset_ns": None if clock is None else clock.offset_ns,
            "clock_uncertainty_ns": None if clock is None else clock.uncertainty_ns,
            "round_trip_us": None if clock is None else clock.round_trip_ns / 1e3,
        },
        "camera": camera._asdict(),
    }


def _arm_json(state: State) -> JSON:
    def joints_deg(values: tuple[float, ...]) -> list[float]:
        return [round(math.degrees(v), 5) for v in values]

    return {
        "group_state": state.group_state.name.lower(),
        "fault": state.fault.name.lower(),
        "severity": state.severity.name.lower(),
        "emergency_latched": bool(state.flags & FLAG_EMERGENCY_LATCHED),
        "plant_link_ok": bool(state.flags & FLAG_PLANT_LINK_OK),
        "settled": bool(state.flags & FLAG_SETTLED),
        "motion": {"id": state.motion_id, "done": state.motion_done, "segment": state.segment},
        "q_meas_deg": joints_deg(state.q_meas),
        "q_cmd_deg": joints_deg(state.q_cmd),
        "valves": list(state.valves),
        "X_BT": pose_json(from_pose(state.X_BT)),
        "X_BT_cmd": pose_json(from_pose(state.X_BT_cmd)),
        "supply_bar": state.supply_bar,
        "cycle": {
            "count": state.cycle,
            "overruns": state.overruns,
            "lateness_p50_us": state.lateness_p50_us,
            "lateness_p99_us": state.lateness_p99_us,
            "lateness_max_us": state.lateness_max_us,
            "plant_exchange_failures": state.plant_exchange_failures,
        },
        "references_lost": state.references_lost,
        "references_dropped": state.references_dropped,
    }
