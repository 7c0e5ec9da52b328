"""An operation as a resource of the API."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from vision_pc.application.results import JSON
from vision_pc.shell.rest.operations import Operation

_OPERATION_EXAMPLE: JSON = {
    "id": "5f0c2a9be1d4",
    "kind": "look-then-move",
    "state": "succeeded",
    "progress": 1.0,
    "note": "reached: error +0.5 +0.2 -1.0 mm, inside 5 mm",
    "notes": [[0.0, "looking"], [0.23, "look 1: error -328.8 -65.0 +552.2 mm, outside 5 mm"]],
    "request": {"method": "calibrated", "inputs": 1},
    "created_at": 1.7e9,
    "started_at": 1.7e9,
    "ended_at": 1.700000012e9,
    "result": {
        "error_mm": {"x": 0.47, "y": 0.23, "z": -0.98},
        "std_mm": {"x": 0.2, "y": 0.2, "z": 0.6},
        "tolerance_mm": 5.0,
        "verdict": "inside",
        "certain": True,
        "ended": "reached",
    },
    "problem": None,
}


class OperationView(BaseModel):
    """An operation resource. ``result`` once it has succeeded, ``problem`` (RFC 9457) once it has failed."""

    model_config = ConfigDict(json_schema_extra={"examples": [_OPERATION_EXAMPLE]})

    id: str
    kind: str
    state: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    progress: float = Field(ge=0.0, le=1.0)
    note: str
    notes: list[tuple[float, str]]
    request: JSON
    created_at: float
    started_at: float | None
    ended_at: float | None
    result: JSON | None
    problem: JSON | None


def operation_view(operation: Operation) -> OperationView:
    """The resource of an operation. Times are seconds since 1970."""
    fields = {name: getattr(operation, name) for name in OperationView.model_fields}
    return OperationView.model_construct(  # validated by the loop that answers, not by the one that runs it
        **fields | {"state": operation.state.value, "notes": list(operation.notes)}
    )
