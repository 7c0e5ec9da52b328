"""The page on routes: its route is served beside ours."""

import re
from typing import Any

from httpx import ASGITransport, AsyncClient

from tests.support.pages import page
from tests.vision_pc.synthetic_station import bench
from vision_pc.shell.rest.api import create_app


async def test_the_route_of_the_page_answers() -> None:
    (block,) = re.findall(r"```python\n(.*?)```", page("how_to/add_a_route.md"), re.DOTALL)
    made_there: dict[str, Any] = {}
    exec(block, made_there)
    async with bench() as made:
        app = create_app(made.station, made.operations)
        made_there["add_reach"](app, made.station)
        async with AsyncClient(transport=ASGITransport(app), base_url="http://test") as client:
            boom = made.station.dimensions
            answer = (await client.get("/arm")).json()
    assert answer == {"reach_m": boom.boom + boom.forearm + boom.wrist_to_tool}
