"""The studio on a loopback port of its own: over a recording, or connected to a live face."""

import contextlib
import json
import sys
import threading
import urllib.parse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.responses import FileResponse, JSONResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from foundation.ports import bound_tcp

STUDIO = Path(sys.prefix) / "viewer"  # where `make viewer` puts it
_PAGE = Path(__file__).with_name("page.html")
_START_S = 20.0


@contextlib.contextmanager
def served(layout: str, recording: Path | None = None) -> Iterator[str]:
    """The origin at which the studio has this ``layout`` and, at ``/recording.mcap``, the ``recording``."""
    listener = bound_tcp("127.0.0.1", 0, "viewer")
    port = listener.getsockname()[1]
    shown = as_called_in_1_48(json.loads(layout))
    routes: list[Any] = [
        Route("/", lambda _: FileResponse(_PAGE)),
        Route("/layout.json", lambda _: JSONResponse(shown)),
        *(Mount(f"/{name}", StaticFiles(directory=STUDIO / name)) for name in ("react", "react-dom")),
        Mount("/", StaticFiles(directory=STUDIO / "studio")),
    ]
    if recording is not None:
        routes.insert(0, Route("/recording.mcap", lambda _: FileResponse(recording)))
    config = uvicorn.Config(Starlette(routes=routes), log_level="error", lifespan="off")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{port}"
    finally:
        server.should_exit = True
        thread.join(_START_S)


def address(origin: str, live: str | None = None, at: str | None = None) -> str:
    """The page's address over the recording, ``at`` an instant (RFC 3339), or over a ``live`` face (ws://…)."""
    source = "remote-file" if live is None else "foxglove-websocket"
    query = {"ds": source, "ds.url": live or f"{origin}/recording.mcap", "layoutId": "ours"}
    if at is not None:
        query["time"] = at
    return f"{origin}/?{urllib.parse.urlencode(query)}"


def as_called_in_1_48(layout: dict[str, Any]) -> dict[str, Any]:
    """A copy with the picture's panel as this version has it; every viewer after it calls the panel Image."""
    text = json.dumps(layout).replace('"Image!', '"ImageViewPanel!')
    changed: dict[str, Any] = json.loads(text)
    for name, panel in changed["configById"].items():
        if name.startswith("ImageViewPanel!"):
            mode = panel.pop("imageMode")
            panel["cameraTopic"] = mode["imageTopic"]
            panel["enabledMarkerTopics"] = list(mode["annotations"])
    return changed
