"""The page at ``/docs``: Swagger UI over the API's own schema, from files of this package alone."""

from importlib.resources import files

from fastapi import FastAPI

from foundation.rest.files import PageFiles, add_files


def add_docs(app: FastAPI) -> None:
    """Adds ``/docs``, which loads nothing from elsewhere.

    FastAPI's own pages do: make ``app`` with ``docs_url=None, redoc_url=None``.
    """
    add_files(app, PageFiles(files("foundation.rest") / "docs", "/docs/files", "/docs"))
