"""Guided hand-eye calibration as programs: the rows of its long steps."""

from collections.abc import Callable, Coroutine
from typing import Any

from pydantic import Field

from foundation.configuration import validated
from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import RequestBody
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.program import MOVING, STANDING, Need, Program
from vision_pc.application.results import JSON
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.core.ports import Report

HAND_EYE = "hand-eye"
"""Tag of these programs: they are there when the application has a guided session."""


class StartSettings(GuidedSettings):
    """A new session: its name, the seed of its proposals, and the session's own settings."""

    name: str = ""
    seed: int = 1

    @property
    def session(self) -> GuidedSettings:
        """The session's own settings."""
        return validated(GuidedSettings, self.model_dump(exclude={"name", "seed"}), "request")


class StartBody(RequestBody):
    """A new session; what is not given is as configured."""

    name: str = Field(examples=["monday"], min_length=1, max_length=64)
    marker_id: int | None = Field(None, ge=0, le=1023, examples=[582])
    marker_size_m: float | None = Field(None, gt=0.005, le=2.0, examples=[0.05])
    poses: int | None = Field(None, ge=5, le=100, examples=[17])
    seed: int = Field(1, ge=0, le=2**31, description="The same seed proposes among the same views")


class NextBody(RequestBody):
    """``informative`` false: any pose that keeps the bounds, for comparison."""

    informative: bool = True


def _row(
    name: str,
    title: str,
    run: Callable[[VisionApplication, Any, Report], Coroutine[Any, Any, JSON]],
    needs: tuple[Need, ...],
    body: type[RequestBody] = RequestBody,
    settings: Callable[[VisionApplication], Any] | None = None,
) -> Program[Any, JSON]:
    """The row of one step of the session; its core is the step of that name."""
    core = getattr(GuidedCalibration, name, GuidedCalibration.next_pose)
    return Program(
        f"{HAND_EYE}-{name}", title, run, dict, body, settings, needs, core, "docs/hand_eye.md", HAND_EYE
    )


async def _start(application: VisionApplication, request: StartSettings, report: Report) -> JSON:
    return await application.guided.start(request.name, request.session, request.seed, report)


HAND_EYE_PROGRAMS = (
    _row(
        "start",
        "Check the starting pose and open a session",
        _start,
        STANDING,
        StartBody,
        lambda app: StartSettings(**app.guided.defaults.model_dump()),
    ),
    _row(
        "next",
        "Propose and drive until the controller accepts a pose",
        lambda app, request, report: app.guided.next_pose(report, request.informative),
        MOVING,
        NextBody,
    ),
    _row(
        "back",
        "Drive back to the starting pose, over the samples where need be",
        lambda app, _, report: app.guided.back(report),
        MOVING,
    ),
    _row(
        "sample",
        "Take a sample where the arm stands, once it has settled",
        lambda app, _, report: app.guided.sample(report),
        STANDING,
    ),
    _row(
        "solve",
        "X with covariance, residuals, proof and verdict",
        lambda app, _, _report: app.guided.solve(),
        STANDING,
    ),
)
