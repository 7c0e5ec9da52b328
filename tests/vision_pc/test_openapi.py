"""The REST API as a document, pinned byte for byte: what a client relies on changes on purpose or not at all.

``python -m tests.vision_pc.test_openapi`` writes it anew.
"""

import asyncio
import difflib
import json
from pathlib import Path
from typing import Any, cast

from tests.vision_pc.synthetic_station import bench
from vision_pc.shell.rest.api import DOCUMENT, create_app

PINNED = Path(str(DOCUMENT))
RENEW = "python -m tests.vision_pc.test_openapi"


async def document() -> str:
    async with bench() as made:
        made.station.hand_eye = cast(Any, object())  # its routes are there, unasked
        app = create_app(made.station, made.operations)
        return json.dumps(app.openapi(), indent=1, ensure_ascii=False) + "\n"


def test_the_api_is_the_pinned_one() -> None:
    pinned, now = PINNED.read_text(encoding="utf-8").splitlines(), asyncio.run(document()).splitlines()
    changes = list(difflib.unified_diff(pinned, now, "pinned", "now", n=1, lineterm=""))
    assert changes == [], f"the API has changed; if it is meant: {RENEW}"


if __name__ == "__main__":
    PINNED.write_text(asyncio.run(document()), encoding="utf-8")
