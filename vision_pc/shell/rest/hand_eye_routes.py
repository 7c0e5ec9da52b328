"""Routes of the guided hand-eye session as a resource; its long steps are programs."""

from enum import Enum

from fastapi import FastAPI
from pydantic import BaseModel, Field, computed_field

from vision_pc.application.bodies import RequestBody
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.hand_eye.responses import session_json
from vision_pc.application.hand_eye_programs import NextBody
from vision_pc.core.hand_eye.guided.session import proposal_json
from vision_pc.shell.rest.operations import Operations

_TAG: list[str | Enum] = ["hand-eye"]


class ResumeBody(RequestBody):
    """A session that is on the disk."""

    name: str = Field(examples=["monday"], min_length=1, max_length=64)


class SampleView(BaseModel):
    """A sample; residuals in camera axes by what is believed at present."""

    name: str
    residual_mm: tuple[float, float, float]
    residual_deg: tuple[float, float, float]
    distance_m: float
    settled: bool


class ProposalView(BaseModel):
    """A pose to go to, and what it is worth; matrices are rows of 4×4, metres.

    ``X_BT`` of the tool, ``X_CP`` of the pattern (the calibration marker) in the camera there.
    """

    X_BT: list[list[float]]
    X_CP: list[list[float]]
    pixel: tuple[float, float]
    distance_m: float
    obliquity_deg: float
    gain_nats: float
    std_after_mm: float
    std_after_deg: float
    choices: int

    @computed_field(json_schema_extra={"deprecated": True})  # type: ignore[prop-decorator]
    @property
    def X_CT(self) -> list[list[float]]:
        """The former name of ``X_CP``."""
        return self.X_CP


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


def add_session(app: FastAPI, operations: Operations, guided: GuidedCalibration) -> None:
    """Adds reading and changing the session to ``app``; its long steps are programs."""

    @app.get("/hand-eye/sessions", tags=_TAG, summary="The sessions on the disk")
    async def sessions() -> SessionNames:
        return SessionNames(names=guided.store.names())

    @app.get("/hand-eye/session", tags=_TAG, summary="The open session with its samples and residuals")
    async def session() -> SessionView:
        """409 when none is open."""
        return SessionView.model_validate(session_json(guided.session))

    @app.post("/hand-eye/session/resume", tags=_TAG, summary="Open a session from the disk")
    async def resume(body: ResumeBody) -> SessionView:
        operations.refuse_busy()
        return SessionView.model_validate(session_json(guided.resume(body.name)))

    @app.post("/hand-eye/session/propose", tags=_TAG, summary="The next pose: the most informative in view")
    async def propose(body: NextBody | None = None) -> ProposalView:
        operations.refuse_busy()
        proposal = await guided.propose((body or NextBody()).informative)
        return ProposalView.model_validate(proposal_json(proposal))

    @app.delete("/hand-eye/session/samples/{name}", tags=_TAG, summary="Leave a sample out for good")
    async def remove(name: str) -> SessionView:
        operations.refuse_busy()
        return SessionView.model_validate(session_json(guided.remove(name)))
