"""Files of pages: served by their names, with a policy; nothing else can be had."""

from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from foundation.rest.files import PageFiles, add_files


@pytest.fixture
def client(tmp_path: Path) -> httpx.AsyncClient:
    folder = tmp_path / "page"
    (folder / "vendor").mkdir(parents=True)
    (tmp_path / "secret.js").write_text("secret")
    (folder / "index.html").write_text("<!doctype html>")
    (folder / "app.js").write_text("// ours")
    (folder / "vendor" / "theirs.js").write_text("// theirs")
    app = FastAPI(docs_url=None, redoc_url=None)
    add_files(app, PageFiles(folder, "/page", "/"))
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://files")


async def test_files_are_served_by_name_with_type_and_policy(client: httpx.AsyncClient) -> None:
    index = await client.get("/")
    assert index.headers["content-type"] == "text/html; charset=utf-8"
    assert "script-src 'self'" in index.headers["content-security-policy"]
    assert "unsafe" not in index.headers["content-security-policy"]
    ours = await client.get("/page/app.js")
    assert "/javascript" in ours.headers["content-type"]  # else a module is not run
    assert ours.text == "// ours"
    assert (await client.get("/page/vendor/theirs.js")).text == "// theirs"


@pytest.mark.parametrize(
    "path",
    [
        "/page/../secret.js",
        "/page/%2e%2e/secret.js",
        "/page/",
        "/page/vendor",
        "/secret.js",
    ],
)
async def test_nothing_else_can_be_had(client: httpx.AsyncClient, path: str) -> None:
    answer = await client.get(httpx.URL(f"http://files{path}"))
    assert answer.status_code == 404


async def test_who_has_the_file_is_told_so(client: httpx.AsyncClient) -> None:
    first = await client.get("/page/app.js")
    again = await client.get("/page/app.js", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    other = await client.get("/page/app.js", headers={"If-None-Match": '"another"'})
    assert other.status_code == 200
