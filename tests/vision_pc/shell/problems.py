"""Problem documents of the REST face, checked to be ones."""

from typing import Any

import httpx


def refused(answer: httpx.Response, status: int, cause: str) -> dict[str, Any]:
    """The problem document of an ``answer`` with this ``status`` and ``cause``."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    document: dict[str, Any] = answer.json()
    assert document["cause"] == cause
    assert document["status"] == status
    assert document["type"] == f"urn:longreach:{cause}"
    assert "\n" not in document["detail"]
    assert document["title"]
    return document
