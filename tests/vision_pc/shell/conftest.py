"""A station in process for every test that asks for one."""

from collections.abc import AsyncIterator

import pytest

from tests.vision_pc.synthetic_station import Bench, bench


@pytest.fixture
async def station() -> AsyncIterator[Bench]:
    async with bench() as made:
        yield made
