"""Routes of the guided hand-eye session as a resource; its long steps are programs."""

from enum import Enum

from fastapi import FastAPI
from pydantic import Field

from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import RequestBody
from vision_pc.application.hand_eye.responses import session_json
from vision_pc.application.results import JSON
from vision_pc.shell.rest.operations import Operations

_TAG: list[str | Enum] = ["hand-eye"]


class ResumeBody(RequestBody):
    """A session that is on the disk."""

    name: str = Field(examples=["monday"], min_length=1, max_length=64)


def add_session(app: FastAPI, operations: Operations, application: VisionApplication) -> None:
    """Adds reading and changing the session to ``app``; its long steps are programs."""

    @app.get("/hand-eye/sessions", tags=_TAG, summary="The sessions on the disk")
    async def sessions() -> JSON:
        return {"names": application.guided.store.names()}

    @app.get("/hand-eye/session", tags=_TAG, summary="The open session with its samples and residuals")
    async def session() -> JSON:
        """409 when none is open."""
        return session_json(application.guided.session)

    @app.post("/hand-eye/session/resume", tags=_TAG, summary="Open a session from the disk")
    async def resume(body: ResumeBody) -> JSON:
        operations.refuse_busy()
        return session_json(application.guided.resume(body.name))

    @app.delete("/hand-eye/session/samples/{name}", tags=_TAG, summary="Leave a sample out for good")
    async def remove(name: str) -> JSON:
        operations.refuse_busy()
        return session_json(application.guided.remove(name))
