"""The operator's page over a recording, at an address of its own: read only, with play, pause and seek."""

import asyncio
import html
import json
import signal
import socket
import time
import uuid
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.responses import HTMLResponse, StreamingResponse
from pydantic import BaseModel, Field

from foundation.recording.reading import RecordingUnreadable
from foundation.rest.files import PAGE_POLICY, add_files
from foundation.rest.server import RestServer, install_problems
from foundation.rest.tokens import Role
from protocol.errors import RequestRefused
from testbed.recordings.console.moments import Moments
from testbed.recordings.console.shown_pictures import ShownPictures
from testbed.recordings.console.timeline import Timeline
from testbed.recordings.console.transport import SPEEDS, Transport
from testbed.recordings.recorded_vision import RecordedVision
from vision_pc.application.results import JSON
from vision_pc.shell.rest.console.broadcast import Broadcast
from vision_pc.shell.rest.console.pictures import packed
from vision_pc.shell.rest.console.routes import PAGE, AccessView
from vision_pc.shell.rest.problems import STATUS_OF_CAUSE

_PERIOD_S, _MOST = 0.1, 16
_PICTURE_AGAIN_NS = 500_000_000  # for pages that came meanwhile: a page greys what is older than a second


class TransportBody(BaseModel, extra="forbid"):
    """What to change of the playback; what is not given stays."""

    playing: bool | None = None
    at_s: float | None = Field(default=None, ge=0.0, allow_inf_nan=False)
    speed: float | None = Field(default=None, json_schema_extra={"enum": list(SPEEDS)})


class RecordedConsole:
    """What all open pages share: one transport, one stream of state, one of pictures.

    ``now_ns``: a clock that goes on while it plays. Once it is ``ended`` both streams end.
    """

    def __init__(
        self, timeline: Timeline, pictures: ShownPictures, now_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self.moments = Moments(timeline)
        self.transport = Transport(timeline.last_ns - timeline.first_ns, since_ns=now_ns())
        self._of, self._pictures, self._now_ns = timeline, pictures, now_ns
        self._instance = uuid.uuid4().hex[:8]
        self._number = 0
        self.ended = False
        self._picture: tuple[Any, int] = (None, 0)
        self._note = ""
        self.state = Broadcast(self._snapshot, _PERIOD_S, _MOST, "the state")
        self.pictures = Broadcast(self._next_picture, _PERIOD_S, _MOST, "the pictures")

    async def until_ended(self, broadcast: Broadcast) -> AsyncIterator[bytes]:
        """What is made from now on; the server waits for its streams when it ends."""
        async for each in broadcast.follow():
            yield each
            if self.ended:
                return

    @property
    def time_ns(self) -> int:
        """The moment that is shown, on vision's clock."""
        return self._of.first_ns + self.transport.position_ns(self._now_ns())

    def change(self, body: TransportBody) -> JSON:
        """Change the playback; return how it stands. Raises RequestRefused."""
        self.transport = self.transport.changed(self._now_ns(), body.playing, body.at_s, body.speed)
        return self.standing()

    def standing(self) -> JSON:
        """How the playback stands."""
        now_ns = self._now_ns()
        return {
            "file": self._of.recording.path.name,
            "at_s": 1e-9 * self.transport.position_ns(now_ns),
            "length_s": 1e-9 * self.transport.length_ns,
            "playing": self.transport.plays(now_ns),
            "speed": self.transport.speed,
            "speeds": SPEEDS,
            "jumps": self.transport.jumps,
            "pictures": self._note or self._pictures.source,
            "states": self._of.without_states or "as recorded",
            "damaged": len(self._of.damages),
        }

    async def _snapshot(self) -> bytes:
        """The next event of the stream of state."""
        self._number += 1
        document = self.moments.document(self.time_ns) | {
            "number": self._number,
            "service": {"instance": self._instance, "started_at": 0.0},
            "watchers": self.state.followers,
            "recorded": self.standing(),
        }
        data = json.dumps(document, separators=(",", ":"), allow_nan=False)
        return f"id: {self._number}\nevent: snapshot\ndata: {data}\n\n".encode()

    async def _next_picture(self) -> bytes:
        """The message of the first other picture, or the same again after a while."""
        while True:
            time_ns = self.time_ns
            try:
                shown = await asyncio.to_thread(self._pictures.of, time_ns)
            except RecordingUnreadable as error:
                shown, self._note = None, f"none: {error}"
            now_ns = self._now_ns()
            if shown is not None and (
                shown is not self._picture[0] or now_ns - self._picture[1] >= _PICTURE_AGAIN_NS
            ):
                self._picture, self._note = (shown, now_ns), shown.note
                return packed(shown.frame_id, shown.capture_ns, time_ns, shown.left, shown.right)
            await asyncio.sleep(_PERIOD_S)


def recorded_app(console: RecordedConsole) -> FastAPI:
    """The page, and what it lives on."""
    app = FastAPI(title="Longreach recording", docs_url=None, redoc_url=None, openapi_url=None)
    install_problems(app, STATUS_OF_CAUSE)
    _add_page(app, console.standing()["file"])

    @app.get("/events", response_class=StreamingResponse)
    async def events() -> StreamingResponse:
        console.state.refuse_more()
        return StreamingResponse(console.until_ended(console.state), media_type="text/event-stream")

    @app.get("/camera/live", response_class=StreamingResponse)
    async def live() -> StreamingResponse:
        console.pictures.refuse_more()
        return StreamingResponse(console.until_ended(console.pictures), media_type="application/octet-stream")

    @app.get("/recording")
    async def standing() -> JSON:
        return console.standing()

    @app.post("/recording")
    async def change(body: TransportBody) -> JSON:
        return console.change(body)

    @app.get("/operations/{number}")
    async def operation(number: str) -> JSON:
        found = console.moments.result(number, console.time_ns)
        if found is None:
            raise RequestRefused("refused.unknown_operation", f"no operation '{number}' has ended by now")
        return found

    return app


def _add_page(app: FastAPI, file: str) -> None:
    """The console's page, which says of itself that it shows a recording, and what it asks for first."""
    said = f'<html lang="en" data-recorded="{html.escape(file)}">'
    page = PAGE.text("/").replace('<html lang="en">', said, 1)

    @app.get("/", include_in_schema=False)
    async def index() -> HTMLResponse:
        return HTMLResponse(page, headers={"Content-Security-Policy": PAGE_POLICY})

    add_files(app, PAGE)

    @app.get("/access")
    async def access() -> AccessView:
        return AccessView(role=Role.LOOK, token_wanted=False)


def show_recording(
    recording: RecordedVision, truth: Path | None, port: int, told: Callable[[str, Timeline, str], None]
) -> None:
    """Serve the console of a recording on the loopback until it is interrupted.

    ``truth``: the plant's recording, by default that of the same run. ``port`` 0: a free one. ``told`` gets
    its address, what was read, and where pictures come from. Raises OSError, RecordingUnreadable.
    """
    run = recording.run
    timeline = Timeline(recording, run / "controller" / "controller.mcap")
    pictures = ShownPictures(timeline, truth or run / "plant_emulator" / "truth.mcap")
    with socket.create_server(("127.0.0.1", port)) as listener:
        told(f"http://127.0.0.1:{listener.getsockname()[1]}/", timeline, pictures.source)
        asyncio.run(_serve(RecordedConsole(timeline, pictures), listener))


async def _serve(console: RecordedConsole, listener: socket.socket) -> None:
    server = RestServer(recorded_app(console))

    def end() -> None:
        console.ended = server.should_exit = True

    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end)
    await server.serve([listener])
