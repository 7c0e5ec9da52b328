"""Files of pages that a REST API serves beside its resources: by name, compressed once, never by path."""

import asyncio
import gzip
import hashlib
from collections.abc import Mapping
from http import HTTPStatus
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import NamedTuple

from fastapi import FastAPI, Request, Response

from foundation.rest.problems import NO_FRAMES

PAGE_POLICY = (
    f"default-src 'none'; {NO_FRAMES}; connect-src 'self'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data: blob:; font-src 'self'"
)
_MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".md": "text/plain; charset=utf-8",
}


class _Served(NamedTuple):
    """A file as it crosses the wire."""

    body: bytes
    zipped: bytes
    etag: str


class PageFiles:
    """The files of ``folder`` and of its folder ``vendor`` by the path that each is served at.

    ``at``: the folder's own path; its ``index.html`` is served at ``index``.
    """

    def __init__(self, folder: Traversable, at: str, index: str) -> None:
        self._files = dict(_files_below(folder, at))
        self._files[index] = self._files.pop(f"{at}/index.html")
        self._served: dict[str, _Served] = {}

    @property
    def paths(self) -> frozenset[str]:
        """What is served."""
        return frozenset(self._files)

    def text(self, path: str) -> str:
        """A file's text, by the path that it is served at."""
        return self._files[path].read_text(encoding="utf-8")

    async def answer(self, path: str, headers: Mapping[str, str], policy: str = PAGE_POLICY) -> Response:
        """The response to a GET: compressed where the client can read that, 304 where it has the file.

        ``policy``: what the page may do.
        """
        served = self._served.get(path)
        if served is None:  # in a thread: this loop may have a stop to serve
            served = self._served[path] = await asyncio.to_thread(_load, self._files[path])
        media_type = _MEDIA_TYPES["." + self._files[path].name.rpartition(".")[2]]
        reply = {"ETag": served.etag, "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
        reply["Content-Security-Policy"] = policy
        if headers.get("if-none-match") == served.etag:
            return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=reply)
        if "gzip" in headers.get("accept-encoding", ""):
            return Response(
                served.zipped, media_type=media_type, headers=reply | {"Content-Encoding": "gzip"}
            )
        return Response(served.body, media_type=media_type, headers=reply)


def add_files(app: FastAPI, files: PageFiles, asks: str = "") -> None:
    """Adds a route for each of ``files``, none of them in the schema.

    ``asks``: an address, beside its own, that a page of theirs may ask.
    """
    policy = PAGE_POLICY.replace("connect-src 'self'", f"connect-src 'self' {asks}") if asks else PAGE_POLICY

    async def file(request: Request) -> Response:
        return await files.answer(request.url.path, request.headers, policy)

    for path in sorted(files.paths):
        app.add_api_route(path, file, include_in_schema=False)


def _files_below(folder: Traversable, at: str) -> list[tuple[str, Traversable]]:
    found = []
    for entry in folder.iterdir():
        if entry.is_dir() and entry.name == "vendor":
            found += _files_below(entry, f"{at}/vendor")
        elif entry.is_file() and "." + entry.name.rpartition(".")[2] in _MEDIA_TYPES:
            found.append((f"{at}/{entry.name}", entry))
    return found


def _load(file: Traversable) -> _Served:
    body = file.read_bytes()
    return _Served(body, gzip.compress(body, mtime=0), f'"{hashlib.sha256(body).hexdigest()[:32]}"')


def add_docs(app: FastAPI) -> None:
    """Adds ``/docs``, which loads nothing from elsewhere.

    FastAPI's own pages do: make ``app`` with ``docs_url=None, redoc_url=None``.
    """
    add_files(app, PageFiles(files("foundation.rest") / "docs", "/docs/files", "/docs"))
