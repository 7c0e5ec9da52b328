"""Routes of guided hand-eye calibration: the session as a resource, its long steps as operations."""

from collections.abc import Awaitable, Callable
from enum import Enum
from http import HTTPStatus
from typing import Annotated

from fastapi import FastAPI, Header, Response
from pydantic import BaseModel, Field

from foundation.configuration import validated
from protocol.errors import RequestRefused
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.operations import Operations
from vision_pc.application.schemas import JSON, Body, OperationView, operation_view
from vision_pc.application.station import Station
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.core.ports import Report

Key = Annotated[
    str | None,
    Header(alias="Idempotency-Key", min_length=1, max_length=100, description="Same key, same operation"),
]
_TAG: list[str | Enum] = ["hand-eye"]
_STANDING = (
    "hand-eye-start",
    "hand-eye-sample",
    "hand-eye-solve",
    "hand-eye-locate",
)  # nothing moves: no need to be enabled


class StartBody(Body):
    """A new session; what is not given is as configured."""

    name: str = Field(examples=["monday"], min_length=1, max_length=64)
    marker_id: int | None = Field(None, ge=0, le=1023, examples=[582])
    marker_size_m: float | None = Field(None, gt=0.005, le=2.0, examples=[0.05])
    poses: int | None = Field(None, ge=5, le=100, examples=[17])
    seed: int = Field(1, ge=0, le=2**31, description="The same seed proposes among the same views")


class ResumeBody(Body):
    """A session that is on the disk."""

    name: str = Field(examples=["monday"], min_length=1, max_length=64)


class NextBody(Body):
    """``informative`` false: any pose that keeps the bounds, for comparison."""

    informative: bool = True


class RedoBody(Body):
    """The sample to take again at its own pose."""

    sample: str = Field(examples=["3"], min_length=1, max_length=64)


class EmptyBody(Body):
    """Nothing needs to be said."""


class SampleView(BaseModel):
    """A sample; residuals in camera axes by what is believed at present."""

    name: str
    residual_mm: tuple[float, float, float]
    residual_deg: tuple[float, float, float]
    distance_m: float
    settled: bool


class ProposalView(BaseModel):
    """A pose to go to, and what it is worth; matrices are rows of 4×4, metres."""

    X_BT: list[list[float]]
    X_CT: list[list[float]]
    pixel: tuple[float, float]
    distance_m: float
    obliquity_deg: float
    gain_nats: float
    std_after_mm: float
    std_after_deg: float
    choices: int


class SessionView(BaseModel):
    """The open session. ``std_*``: how well X is known, by the noise assumed in planning."""

    name: str
    count: str
    complete: bool
    marker_id: int
    samples: list[SampleView]
    std_mm: float | None
    std_deg: float | None
    proposal: ProposalView | None
    refused: int


class SessionNames(BaseModel):
    """The sessions on the disk."""

    names: list[str]


def add_hand_eye(app: FastAPI, station: Station, operations: Operations, guided: GuidedCalibration) -> None:
    """Adds all routes of guided calibration to ``app``."""
    _add_session(app, operations, guided)
    _add_operations(app, station, operations, guided)


def _add_session(app: FastAPI, operations: Operations, guided: GuidedCalibration) -> None:
    def refuse_busy() -> None:
        if operations.current is not None:
            running = operations.current
            raise RequestRefused("refused.busy", f"operation {running.id} ({running.kind}) is still running")

    @app.get("/hand-eye/sessions", tags=_TAG, summary="The sessions on the disk")
    async def sessions() -> SessionNames:
        return SessionNames(names=guided.store.names())

    @app.get("/hand-eye/session", tags=_TAG, summary="The open session with its samples and residuals")
    async def session() -> SessionView:
        """409 when none is open."""
        return SessionView.model_validate(guided.view())

    @app.post("/hand-eye/session/resume", tags=_TAG, summary="Open a session from the disk")
    async def resume(body: ResumeBody) -> SessionView:
        refuse_busy()
        return SessionView.model_validate(guided.resume(body.name))

    @app.post("/hand-eye/session/propose", tags=_TAG, summary="The next pose: the most informative in view")
    async def propose(body: NextBody | None = None) -> ProposalView:
        refuse_busy()
        return ProposalView.model_validate(await guided.propose((body or NextBody()).informative))

    @app.delete("/hand-eye/session/samples/{name}", tags=_TAG, summary="Leave a sample out for good")
    async def remove(name: str) -> SessionView:
        refuse_busy()
        return SessionView.model_validate(guided.remove(name))


def _add_operations(
    app: FastAPI, station: Station, operations: Operations, guided: GuidedCalibration
) -> None:
    def begin(
        kind: str,
        body: Body,
        program: Callable[[Report], Awaitable[JSON]],
        key: str | None,
        response: Response,
    ) -> OperationView:
        request: JSON = body.model_dump(mode="json", exclude_none=True)
        operation = operations.repeated(kind, request, key)
        if operation is None:
            station.refuse_now("look" if kind in _STANDING else kind)
            operation = operations.start(kind, request, program, key)
        response.headers["Location"] = f"/operations/{operation.id}"
        return operation_view(operation)

    def post(kind: str, summary: str) -> Callable[..., Callable[..., Awaitable[OperationView]]]:
        return app.post(
            f"/operations/{kind}",
            tags=_TAG,
            summary=summary,
            status_code=HTTPStatus.ACCEPTED,
            operation_id=kind.replace("-", "_"),
            responses={202: {"headers": {"Location": {"schema": {"type": "string"}}}}},
        )

    @post("hand-eye-start", "Check the starting pose and open a session")
    async def start(response: Response, body: StartBody, key: Key = None) -> OperationView:
        given = body.overrides()
        name, seed = given.pop("name"), given.pop("seed")
        settings = validated(GuidedSettings, guided.defaults.model_dump() | given, "request")
        return begin("hand-eye-start", body, lambda r: guided.start(name, settings, seed, r), key, response)

    @post("hand-eye-go", "Drive to the proposed pose")
    async def go(response: Response, body: EmptyBody | None = None, key: Key = None) -> OperationView:
        return begin("hand-eye-go", body or EmptyBody(), guided.go, key, response)

    @post("hand-eye-next", "Propose and drive until the controller accepts a pose")
    async def following(response: Response, body: NextBody | None = None, key: Key = None) -> OperationView:
        asked = body or NextBody()
        return begin("hand-eye-next", asked, lambda r: guided.next_pose(r, asked.informative), key, response)

    @post("hand-eye-back", "Drive back to the starting pose, over the samples where need be")
    async def back(response: Response, body: EmptyBody | None = None, key: Key = None) -> OperationView:
        return begin("hand-eye-back", body or EmptyBody(), guided.back, key, response)

    @post("hand-eye-sample", "Take a sample where the arm stands, once it has settled")
    async def sample(response: Response, body: EmptyBody | None = None, key: Key = None) -> OperationView:
        return begin("hand-eye-sample", body or EmptyBody(), guided.sample, key, response)

    @post("hand-eye-redo", "Drive back to a sample's pose and take it again")
    async def redo(response: Response, body: RedoBody, key: Key = None) -> OperationView:
        return begin("hand-eye-redo", body, lambda r: guided.redo(body.sample, r), key, response)

    @post("hand-eye-locate", "Knob, switch and key hole of the cabinet, in hand and base")
    async def locate(response: Response, body: EmptyBody | None = None, key: Key = None) -> OperationView:
        return begin("hand-eye-locate", body or EmptyBody(), guided.locate, key, response)

    @post("hand-eye-solve", "X with covariance, residuals, proof and verdict")
    async def solve(response: Response, body: EmptyBody | None = None, key: Key = None) -> OperationView:
        return begin("hand-eye-solve", body or EmptyBody(), lambda _report: guided.solve(), key, response)
