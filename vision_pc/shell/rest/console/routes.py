"""The console's routes: its page, one stream of state, one of pictures, and who is asking."""

import asyncio
import contextlib
import json
import struct
import time
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
from fastapi import FastAPI, Request
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field

from foundation import clock
from foundation.rest.files import PageFiles, add_files, public_paths
from foundation.rest.guard import Role
from protocol.errors import LongreachError, RequestRefused
from vision_pc.application.application import VisionApplication
from vision_pc.application.console.advice import advice
from vision_pc.application.console.overview import Overview, predicted_by, session_state
from vision_pc.application.results import JSON
from vision_pc.core.types import StereoPair
from vision_pc.shell.rest.operations import Operation, Operations
from vision_pc.shell.rest.state_view import arm_json

PICTURE_PERIOD_S = 0.095  # at most ten a second; a camera of ten a second loses none
HEADER = struct.Struct("<IQQII")
"""Bytes after this header, capture and encoding time (ns, monotonic), frame, bytes of the left eye."""
_LEFT_QUALITY, _RIGHT_QUALITY = 80, 70
_RIGHT_SCALE = 0.5


class LivePictures:
    """Turns the newest pair into the bytes of one message: header, left eye, right eye at half its size."""

    def __init__(self, pair_after: Callable[[int], Awaitable[StereoPair]]) -> None:
        self._pair_after = pair_after
        self._shown_ns = 0
        # Not the eyes' thread: a watcher must neither wait for a measurement nor hold one up.
        self._thread = ThreadPoolExecutor(1, "pictures")

    async def next_message(self) -> bytes:
        """The message of the first pair after the last one. Raises LinkLost while the camera is silent."""
        pair = await self._pair_after(self._shown_ns)
        self._shown_ns = pair.capture_ns
        return await asyncio.get_running_loop().run_in_executor(self._thread, message, pair)


def message(pair: StereoPair) -> bytes:
    """The bytes of one pair: both eyes as JPEG, the right one at half its size."""
    height, width = (round(side * _RIGHT_SCALE) for side in pair.right.shape)
    smaller = cv2.resize(pair.right, (width, height), interpolation=cv2.INTER_AREA)
    left, right = (
        cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        for picture, quality in ((pair.left, _LEFT_QUALITY), (smaller, _RIGHT_QUALITY))
    )
    now_ns, age_ns = time.monotonic_ns(), clock.now_ns() - pair.capture_ns  # the page goes by the wall
    length, frame_id = HEADER.size - 4 + len(left) + len(right), pair.frame_id & 0xFFFFFFFF
    return HEADER.pack(length, now_ns - age_ns, now_ns, frame_id, len(left)) + left + right


_AFTER_TROUBLE_S = 0.25


class Broadcast:
    """``make`` is awaited every ``period_s`` while there are followers; each follower gets the newest.

    A follower that is slow skips what was made meanwhile; nothing waits for it, and nothing is queued. What
    ``make`` raises on purpose is taken for "nothing new"; it is asked again. All in one event loop.
    """

    def __init__(self, make: Callable[[], Awaitable[bytes]], period_s: float, most: int, what: str) -> None:
        self._make, self._period_s, self._most, self._what = make, period_s, most, what
        self._followers = 0
        self._newest = b""
        self._number = 0
        self._news = asyncio.Event()
        self._making: asyncio.Task[None] | None = None

    @property
    def followers(self) -> int:
        """How many follow."""
        return self._followers

    def refuse_more(self) -> None:
        """Raises RequestRefused (``refused.too_many_followers``) when there is no place for one more."""
        if self._followers >= self._most:
            why = f"{self._most} clients follow {self._what} already"
            raise RequestRefused("refused.too_many_followers", why)

    async def follow(self) -> AsyncIterator[bytes]:
        """What is made from now on."""
        self._followers += 1
        if self._making is None:
            self._making = asyncio.create_task(self._keep_making(), name=f"making {self._what}")
        try:
            seen = self._number
            while True:
                while self._number == seen:
                    await self._news.wait()
                seen = self._number
                yield self._newest
        finally:
            self._followers -= 1
            if not self._followers and self._making is not None:
                self._making.cancel()
                self._making = None

    async def _keep_making(self) -> None:
        loop = asyncio.get_running_loop()
        with contextlib.suppress(asyncio.CancelledError):
            while True:
                began_s = loop.time()
                try:
                    self._newest = await self._make()
                except LongreachError:
                    await asyncio.sleep(_AFTER_TROUBLE_S)
                    continue
                self._number += 1
                self._news.set()
                self._news = asyncio.Event()
                await asyncio.sleep(max(self._period_s - (loop.time() - began_s), 0.0))


_STATE_PERIOD_S = 0.1
MOST_OF_STATE, _MOST_OF_PICTURES = 64, 16
_OPERATIONS_SHOWN = 8
_MEASURED_S = 1.0
_TAG: list[Any] = ["console"]

_PAGE = Path(__file__).with_name("page"), "/console", "/"
PUBLIC = public_paths(*_PAGE)  # it asks for the token itself


class AccessView(BaseModel):
    """Who is asking."""

    role: Role = Field(description="look: may read and stop; operate: everything")
    token_wanted: bool = Field(description="whether this service asks for a token at all")
    emulator_face: str | None = Field(
        None, description="address of the emulator's own HTTP face; for the console"
    )


class Console:
    """What all open consoles share."""

    def __init__(
        self,
        application: VisionApplication,
        operations: Operations,
        overview: Overview,
        titles: Mapping[str, str],
        clock: Callable[[], JSON],
    ) -> None:
        """``titles``: of the programs, by name; ``clock``: as the API shows it."""
        self._application, self._operations, self._overview = application, operations, overview
        self._titles, self._clock = titles, clock
        self._instance = uuid.uuid4().hex[:8]
        self._started_s = time.time()
        self._number = 0
        self._failed: set[str] = set()
        self._measured_s = 0.0
        self._measuring: asyncio.Task[None] | None = None
        pictures = LivePictures(lambda after_ns: application.camera.pair_after(after_ns))
        self.state = Broadcast(self._snapshot, _STATE_PERIOD_S, MOST_OF_STATE, "the state")
        self.pictures = Broadcast(pictures.next_message, PICTURE_PERIOD_S, _MOST_OF_PICTURES, "the pictures")

    async def _snapshot(self) -> bytes:
        """The next event of the stream of state."""
        rig, operations = self._application, self._operations.list()[-_OPERATIONS_SHOWN:]
        now_s, look, (state, _) = time.time(), rig.newest_look, session_state(rig.controller)
        self._overview.note(now_s, rig)
        self._note_failures(operations)
        if self.pictures.followers and (not operations or operations[-1].state.ended):
            self._measure_when_due(now_s)
        self._number += 1
        anew_s = self._overview.anew_at or 0.0
        predicted = _predicted_end([each for each in operations if (each.ended_at or now_s) >= anew_s])
        document = {
            "number": self._number,
            "time": now_s,
            "service": {"instance": self._instance, "started_at": self._started_s},
            "watchers": self.state.followers,
            "clock": self._clock(),
            "state": None if state is None else arm_json(state),
            "operations": [_operation_json(each, self._title(each)) for each in operations],
            "told": predicted,
            "looked_at": None if look is None else now_s - 1e-9 * (clock.now_ns() - look.look.time_ns),
        } | self._overview.document(rig, predicted)
        data = json.dumps(document, separators=(",", ":"), allow_nan=False)
        return f"id: {self._number}\nevent: snapshot\ndata: {data}\n\n".encode()

    def _title(self, operation: Operation) -> str:
        return self._titles.get(operation.kind, operation.kind)

    def _note_failures(self, operations: list[Operation]) -> None:
        for operation in operations:
            if operation.problem is not None and operation.id not in self._failed:
                ended_s = operation.ended_at or time.time()
                problem = operation.problem
                detail = f"{self._title(operation)}: {problem['detail']}"
                self._overview.alarms.happened(ended_s, str(problem["cause"]), detail)
        self._failed = {operation.id for operation in operations if operation.problem is not None}

    def _measure_when_due(self, now_s: float) -> None:
        """Have markers looked for in the newest picture; while a program runs it does so."""
        if (self._measuring is None or self._measuring.done()) and now_s - self._measured_s >= _MEASURED_S:
            self._measured_s, self._measuring = now_s, asyncio.create_task(self._measure())

    async def _measure(self) -> None:
        with contextlib.suppress(LongreachError):
            await self._application.camera.observe()


def add_console(app: FastAPI, console: Console, emulator_face: str = "") -> None:
    """Adds the page at ``/`` and what it lives on to ``app``. ``emulator_face``: an address it may ask."""
    add_files(app, PageFiles(*_PAGE, emulator_face))

    @app.get("/access", tags=_TAG, summary="What the token that was sent lets its holder do")
    async def access(request: Request) -> AccessView:
        """Where no token is wanted, everybody operates."""
        role = request.headers.get("longreach-role")  # the door's
        return AccessView(
            role=Role(role or Role.OPERATE), token_wanted=bool(role), emulator_face=emulator_face or None
        )

    @app.get("/events", tags=_TAG, summary="All that a console shows, ten times a second (event stream)",
             response_class=StreamingResponse,
             responses={200: {"content": {"text/event-stream": {}}}})  # fmt: skip
    async def events() -> StreamingResponse:
        """``snapshot`` events: state, links, operations, the newest look, alarms with what to do."""
        console.state.refuse_more()
        return StreamingResponse(console.state.follow(), media_type="text/event-stream")

    @app.get("/camera/live", tags=_TAG, summary="Live pictures of both eyes, at most ten a second",
             response_class=StreamingResponse,
             responses={200: {"content": {"application/octet-stream": {}}}})  # fmt: skip
    async def live() -> StreamingResponse:
        """Messages one after another, little endian: u32 bytes that follow, u64 capture and u64 encoding time
        (ns), u32 frame, u32 bytes of the left eye; then the left eye's JPEG, and the right one's at half
        size. A client that is slow skips pictures.
        """
        console.pictures.refuse_more()
        return StreamingResponse(console.pictures.follow(), media_type="application/octet-stream")


def _predicted_end(operations: list[Operation]) -> JSON | None:
    """What the newest operation told of where it would end; nothing once something else has moved the arm."""
    moving = [operation for operation in operations if operation.kind != "look"]
    return predicted_by(moving[-1].kind, moving[-1].result) if moving else None


def _operation_json(operation: Operation, title: str) -> JSON:
    cause = None if operation.problem is None else str(operation.problem["cause"])
    return {
        "id": operation.id,
        "kind": operation.kind,
        "title": title,
        "state": operation.state.value,
        "request": operation.request,
        "progress": round(operation.progress, 4),
        "note": operation.note,
        "started_at": operation.started_at,
        "ended_at": operation.ended_at,
        "cause": cause,
        "advice": None if cause is None else advice(cause),
    }
