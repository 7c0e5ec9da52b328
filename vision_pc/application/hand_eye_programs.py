"""Guided hand-eye calibration as programs: the rows of its long steps."""

from collections.abc import Callable, Coroutine
from typing import Any

from pydantic import Field

from foundation.configuration import validated
from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import RequestBody, body_of
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.program import MOVING, STANDING, Need, Program
from vision_pc.application.results import JSON
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.core.ports import Report

HAND_EYE = "hand-eye"
"""Tag of these programs: they are there when the application has a guided session."""


class StartBody(RequestBody):
    """A new session; what is not given is as configured."""

    name: str = Field(examples=["monday"], min_length=1, max_length=64)
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
) -> Program[Any, JSON]:
    """The row of one step of the session; its core is the step of that name."""
    core = getattr(GuidedCalibration, name, GuidedCalibration.next_pose)
    return Program(
        f"{HAND_EYE}-{name}", title, run, dict, body, None, needs, core, "docs/hand_eye.md", HAND_EYE
    )


async def _start(application: VisionApplication, request: StartBody, report: Report) -> JSON:
    given = application.guided.defaults.model_dump() | request.overrides()
    name, seed = given.pop("name"), given.pop("seed")
    return await application.guided.start(name, validated(GuidedSettings, given, "request"), seed, report)


HAND_EYE_PROGRAMS = (
    _row(
        "start",
        "Check the starting pose and open a session",
        _start,
        STANDING,
        body_of(GuidedSettings, "marker_id", "marker_size_m", "poses", base=StartBody),
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
