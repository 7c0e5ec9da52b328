"""Pages that a REST API serves beside its resources, under a policy that loads nothing from elsewhere."""

from pathlib import Path
from typing import Any

from fastapi import FastAPI, Response
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles

from foundation.rest.problems import NO_FRAMES

PAGE_POLICY = (
    f"default-src 'none'; {NO_FRAMES}; connect-src 'self'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data: blob:; font-src 'self'"
)


class PageFiles(StaticFiles):
    """The files below ``folder``, served ``at`` a path; its ``index.html`` at the path ``index`` too.

    ``asks``: an address, beside its own, that the page may ask.
    """

    def __init__(self, folder: Path, at: str, index: str, asks: str = "") -> None:
        super().__init__(directory=folder)
        self.folder, self.at, self.index = folder, at, index
        policy = (
            PAGE_POLICY.replace("connect-src 'self'", f"connect-src 'self' {asks}") if asks else PAGE_POLICY
        )
        self._headers = {"Content-Security-Policy": policy, "Cache-Control": "no-cache"}

    def file_response(self, *given: Any, **named: Any) -> Response:
        """The response that serves a file, or says that the client has it."""
        response = super().file_response(*given, **named)
        response.headers.update(self._headers)
        return response

    def index_response(self) -> Response:
        """The page itself."""
        return FileResponse(self.folder / "index.html", headers=self._headers)


def public_paths(folder: Path, at: str, index: str) -> frozenset[str]:
    """What ``PageFiles`` of the same serves."""
    files = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return frozenset((index, *(f"{at}/{path.as_posix()}" for path in files)))


def add_files(app: FastAPI, files: PageFiles) -> None:
    """Adds ``files``, none of them in the schema."""

    async def index() -> Response:
        return files.index_response()

    app.add_api_route(files.index, index, include_in_schema=False)
    app.mount(files.at, files)


def add_docs(app: FastAPI) -> None:
    """Adds ``/docs``, which loads nothing from elsewhere.

    FastAPI's own pages do: make ``app`` with ``docs_url=None, redoc_url=None``.
    """
    add_files(app, PageFiles(Path(__file__).with_name("docs"), "/docs/files", "/docs"))
