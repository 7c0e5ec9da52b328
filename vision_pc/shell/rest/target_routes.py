"""Routes of the targets: a click makes one, detected holes are offered, what is not wanted goes."""

from http import HTTPStatus
from typing import Annotated

from fastapi import FastAPI, Query, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from foundation.numbers_as_written import written_number
from foundation.rest.server import respond
from protocol.errors import LinkLost
from vision_pc.application.application import VisionApplication
from vision_pc.application.console.advice import advice
from vision_pc.application.results import JSON
from vision_pc.application.targets.view import ClickBody, candidate_json, hole_json, target_json
from vision_pc.core.se3 import Array, from_pose
from vision_pc.core.targets.keeper import KeptTarget
from vision_pc.core.targets.target import TargetRefused
from vision_pc.shell.rest.operations import Operations, problem_of


class HolesQuery(BaseModel):
    """What is asked of the newest picture: text, as all in a query."""

    model_config = ConfigDict(extra="forbid")
    detect: bool = False
    diameter_mm: Annotated[float, Field(gt=5.0, le=500.0), BeforeValidator(written_number)] | None = Field(
        None, description="of the holes; left out: as configured"
    )


def add_targets(app: FastAPI, application: VisionApplication, operations: Operations) -> None:
    """Adds making, listing, choosing and forgetting targets to ``app``."""
    _add_making(app, application, operations)
    _add_keeping(app, application, operations)


def _add_making(app: FastAPI, application: VisionApplication, operations: Operations) -> None:
    camera = application.camera

    @app.post("/targets", tags=["targets"], summary="Make a target of what a click in a picture means",
              status_code=HTTPStatus.CREATED)  # fmt: skip
    async def make(body: ClickBody, request: Request) -> Response:
        """201: measured, kept, and aimed at: programs look at it in place of the object's markers. Nothing
        moves.

        422 says why not: ``target.ambiguous`` and ``target.contradicted`` with ``candidates``,
        ``target.low_texture``, ``target.depth_edge``, ``target.not_planar``, ``target.outside_picture``,
        ``target.frame_too_old``, ``target.no_match``, ``target.hidden``, ``target.moves``,
        ``target.no_hole``, ``target.not_round``, ``target.wrong_size``; ``advice`` says what to do.
        """
        operations.refuse_busy()
        try:
            kept = await camera.target_at(body.click(), body.frame_id)
        except TargetRefused as refused:
            candidates = [candidate_json(candidate) for candidate in refused.candidates]
            details = {"instance": request.url.path, "candidates": candidates}
            return respond(problem_of(refused) | details | {"advice": advice(refused.cause)})
        document = _target_view(application, kept)
        application.log.write("target_made", **document)
        return JSONResponse(document, HTTPStatus.CREATED, {"Location": f"/targets/{kept.id}"})


def _add_keeping(app: FastAPI, application: VisionApplication, operations: Operations) -> None:
    camera = application.camera

    @app.get("/targets", tags=["targets"], summary="All targets, and the holes of the newest picture")
    async def every(asked: Annotated[HolesQuery, Query()]) -> JSON:
        """``detect``: also look for holes, which are no targets before they are clicked."""
        document: JSON = {"targets": [_target_view(application, kept) for kept in camera.targets.list()]}
        if asked.detect:
            frame_id, found = await camera.detected_holes(asked.diameter_mm)
            document |= {"frame_id": frame_id, "holes": [hole_json(hole) for hole in found]}
        return document

    @app.get("/targets/{target_id}", tags=["targets"], summary="One target")
    async def one(target_id: str) -> JSON:
        """404 when it is not known."""
        return _target_view(application, camera.targets.get(target_id))

    @app.post("/targets/{target_id}/aim", tags=["targets"], summary="Have programs look at it")
    async def aim(target_id: str) -> JSON:
        """409 while an operation runs."""
        operations.refuse_busy()
        camera.targets.aim(target_id)
        return _target_view(application, camera.targets.get(target_id))

    @app.delete("/targets/{target_id}", tags=["targets"], summary="Forget it",
                status_code=HTTPStatus.NO_CONTENT)  # fmt: skip
    async def forget(target_id: str) -> None:
        """When it was aimed at, programs look at the object's markers again. 409 while an operation runs."""
        operations.refuse_busy()
        camera.targets.remove(target_id)


def _target_view(application: VisionApplication, kept: KeptTarget) -> JSON:
    seen = application.camera.seen()
    X_CM = None if seen is None else seen.observation.X_CM
    p_CM = None if X_CM is None else X_CM[:3, 3]
    return target_json(
        kept, application.camera.targets, application.positioning, p_CM, _unwatched(application)
    )


def _unwatched(application: VisionApplication) -> Array | None:
    """Where the arm stands, X_BT (4, 4), unwatched; None while somebody watches, or nobody knows."""
    if not application.camera.carries:
        return None
    try:
        return from_pose(application.controller.state.X_BT)
    except LinkLost:
        return None
