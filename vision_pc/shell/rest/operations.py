"""Operations: long work as resources. One runs at a time; every one ends in exactly one end state.

An operation is queued when it is accepted, runs as a task, and ends succeeded, failed or cancelled.
Whatever ends it early stops the arm. The same idempotency key gives the same operation again.
"""

import asyncio
import contextlib
import time
import uuid
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from enum import StrEnum
from http import HTTPStatus
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr

from foundation.rest import problems
from protocol.errors import LongreachError, RequestRefused
from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import RequestBody
from vision_pc.application.ports import HealthyLog
from vision_pc.application.program import Program
from vision_pc.application.results import JSON
from vision_pc.core.ports import Report

_REMEMBERED = 200
_KEYS_REMEMBERED = 10_000
Work = Callable[[Report], Awaitable[JSON]]


class OperationState(StrEnum):
    """Where an operation stands."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """Whether nothing will change any more."""
        return self in (OperationState.SUCCEEDED, OperationState.FAILED, OperationState.CANCELLED)


_EXAMPLE: JSON = {
    "id": "5f0c2a9be1d4",
    "kind": "look-then-move",
    "state": "succeeded",
    "progress": 1.0,
    "note": "reached: error +0.5 +0.2 -1.0 mm, inside 5 mm",
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


class Operation(BaseModel):
    """An operation resource. ``result`` once it has succeeded, ``problem`` (RFC 9457) once it has failed.

    Times are seconds since 1970.
    """

    model_config = ConfigDict(
        json_schema_extra={"examples": [_EXAMPLE]}, json_schema_serialization_defaults_required=True
    )

    id: str = Field(default_factory=lambda: uuid.uuid4().hex[:12])
    kind: str
    state: OperationState = OperationState.QUEUED
    progress: float = Field(0.0, ge=0.0, le=1.0)
    note: str = "queued"
    request: JSON
    created_at: float = Field(default_factory=time.time)
    started_at: float | None = None
    ended_at: float | None = None
    result: JSON | None = None
    problem: JSON | None = None
    _end: asyncio.Event = PrivateAttr(default_factory=asyncio.Event)

    async def wait(self) -> None:
        """Return once it has ended."""
        await self._end.wait()

    def report(self, progress: float, note: str) -> None:
        """Notes progress 0…1; without effect once ended."""
        if not self.state.ended:
            self.progress, self.note = min(max(progress, 0.0), 1.0), note


class Operations:
    """Runs one operation at a time. ``halt`` is awaited after an early end, to stop the arm."""

    def __init__(self, halt: Callable[[], Awaitable[None]], log: HealthyLog) -> None:
        self._halt = halt
        self._log = log
        self._all: OrderedDict[str, Operation] = OrderedDict()
        self._keys: OrderedDict[str, str] = OrderedDict()
        self._task: asyncio.Task[None] | None = None
        self.current: Operation | None = None

    def list(self) -> list[Operation]:
        """All that are remembered, oldest first."""
        return [*self._all.values()]

    def get(self, operation_id: str) -> Operation:
        """One operation. Raises RequestRefused (``refused.unknown_operation``)."""
        if operation_id not in self._all:
            raise RequestRefused("refused.unknown_operation", f"no operation '{operation_id}'")
        return self._all[operation_id]

    def start(
        self,
        program: Program[Any, Any],
        application: VisionApplication,
        body: RequestBody,
        key: str | None = None,
    ) -> Operation:
        """A new operation that runs ``program``, or the one that ``key`` already stands for.

        Raises ConfigurationError for settings out of range, RequestRefused or LinkLost when the program
        cannot begin now (``refused.busy`` while one runs), ``refused.key_reused`` for a key of another
        request, ``refused.key_spent`` for that of an operation that is no longer remembered.
        """
        settings = program.requested(application, body)
        request = body.model_dump(mode="json", exclude_none=True)
        earlier = self._repeated(program.name, request, key)
        if earlier is not None:
            return earlier
        program.refuse_now(application, settings)
        self.refuse_busy()

        async def work(report: Report) -> JSON:
            return program.to_json(await program.run(application, settings, report))

        return self._start(Operation(kind=program.name, request=request), work, key)

    def refuse_busy(self) -> None:
        """Raises RequestRefused (``refused.busy``) while an operation runs."""
        if self.current is not None:
            why = f"operation {self.current.id} ({self.current.kind}) is still running"
            raise RequestRefused("refused.busy", why)

    def _repeated(self, kind: str, request: JSON, key: str | None) -> Operation | None:
        """The operation that ``key`` already stands for. Raises RequestRefused when it stands for another."""
        if key is None or key not in self._keys:
            return None
        earlier = self._all.get(self._keys[key])
        if earlier is None:
            why = f"Idempotency-Key '{key}' stood for an operation that is no longer remembered"
            raise RequestRefused("refused.key_spent", why)
        if earlier.kind != kind or earlier.request != request:
            why = f"Idempotency-Key '{key}' stands for another request ({earlier.kind})"
            raise RequestRefused("refused.key_reused", why)
        return earlier

    def _start(self, operation: Operation, work: Work, key: str | None) -> Operation:
        self.current = self._all[operation.id] = operation
        if key:
            self._keys[key] = operation.id
        self._forget_old()
        self._log.write("operation_queued", id=operation.id, kind=operation.kind, request=operation.request)
        self._task = asyncio.create_task(self._run(operation, work), name=f"operation {operation.id}")
        return operation

    async def cancel(self, operation_id: str) -> Operation:
        """The operation, ended. Raises RequestRefused (``refused.already_ended``) if it had ended."""
        operation = self.get(operation_id)
        if operation.state.ended or operation is not self.current or self._task is None:
            raise RequestRefused("refused.already_ended", f"operation {operation_id} has {operation.state}")
        self._task.cancel()
        await asyncio.wait([self._task])
        if not operation.state.ended:  # cancelled before its first step
            self._end(operation, OperationState.CANCELLED, note="cancelled")
        return operation

    async def close(self) -> None:
        """Cancels what runs, if anything."""
        if self.current is not None:
            with contextlib.suppress(RequestRefused):  # it ended just now
                await self.cancel(self.current.id)

    async def _run(self, operation: Operation, work: Work) -> None:
        try:
            operation.state, operation.started_at = OperationState.RUNNING, time.time()
            result = await work(operation.report)
        except asyncio.CancelledError:
            await self._stop_arm(operation)
            self._end(operation, OperationState.CANCELLED, note="cancelled")
        except LongreachError as error:
            await self._stop_arm(operation)
            self._end(operation, OperationState.FAILED, problem=problem_of(error), note=str(error))
        except Exception as error:
            await self._stop_arm(operation)
            self._log.write("operation_broke", "error", id=operation.id, error=repr(error))
            self._end(operation, OperationState.FAILED, problem=problem_of(error), note="internal error")
        else:
            operation.progress = 1.0
            self._end(operation, OperationState.SUCCEEDED, result=result)

    async def _stop_arm(self, operation: Operation) -> None:
        # Shielded: a second cancellation must not leave the arm moving.
        stopping = asyncio.ensure_future(self._halt())
        try:
            await asyncio.shield(stopping)
        except asyncio.CancelledError:
            await asyncio.wait([stopping])
        except LongreachError as error:
            self._log.write("stop_failed", "error", id=operation.id, cause=error.cause, detail=str(error))

    def _end(
        self,
        operation: Operation,
        state: OperationState,
        *,
        result: JSON | None = None,
        problem: JSON | None = None,
        note: str = "",
    ) -> None:
        operation.state, operation.ended_at = state, time.time()
        operation.result, operation.problem = result, problem
        operation.note = note or operation.note
        self.current, self._task = None, None
        self._log.write(
            "operation_ended",
            id=operation.id,
            kind=operation.kind,
            state=state,
            result=result,
            problem=problem,
        )
        operation._end.set()

    def _forget_old(self) -> None:
        while len(self._all) > _REMEMBERED:
            self._all.popitem(last=False)
        while len(self._keys) > _KEYS_REMEMBERED:
            self._keys.popitem(last=False)


STATUS_OF_CAUSE = {
    "refused.unknown_operation": HTTPStatus.NOT_FOUND,
    "refused.unknown_program": HTTPStatus.NOT_FOUND,
    "refused.too_many_followers": HTTPStatus.SERVICE_UNAVAILABLE,
    "refused.key_reused": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.key_spent": HTTPStatus.GONE,
    "request.repeated_header": HTTPStatus.BAD_REQUEST,
    "request.bad_header": HTTPStatus.BAD_REQUEST,
    "refused.unknown_target": HTTPStatus.NOT_FOUND,
    "refused.no_look_yet": HTTPStatus.NOT_FOUND,
    "refused.bad_target": HTTPStatus.UNPROCESSABLE_ENTITY,
    "refused.bad_setting": HTTPStatus.UNPROCESSABLE_ENTITY,
}


def problem_of(error: Exception) -> dict[str, Any]:
    """The problem document of an exception that ended an operation."""
    return problems.problem_of(error, STATUS_OF_CAUSE)
