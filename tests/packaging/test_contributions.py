"""A contribution that follows a how-to page to the letter is green: lint, types, imports, house, tests.

Each page is followed in a copy of the tree. Its code is taken from the page; what a contributor writes freely
(a test, a line of a page) is written here.
"""

import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from tests.support.pages import page
from tests.support.paths import ROOT

pytestmark = [pytest.mark.slow("a copy of the tree is linted, typed and tested"), pytest.mark.timeout(1800)]

NOT_COPIED = shutil.ignore_patterns(
    ".git", ".venv*", ".pytest_cache", ".hypothesis", "__pycache__", "runs", "dist", "build"
)


class Tree:
    """A copy of the repository in which a page is followed."""

    def __init__(self, root: Path) -> None:
        self.root = root
        shutil.copytree(ROOT, root, ignore=NOT_COPIED)

    def put(self, name: str, text: str, before: str = "", after: str = "") -> None:
        """Write ``text`` into a file: before or after the first place of another, or as a new file."""
        path = self.root / name
        old = path.read_text(encoding="utf-8") if before + after else text
        assert before + after in old, f"{name}: {before + after!r}"
        path.write_text(old.replace(before + after, after + text + before, 1) if before + after else text)

    def run(self, *words: str) -> None:
        """Run Python in the copy. Fails with its output where the exit status is not 0."""
        done = subprocess.run(
            [sys.executable, *words], cwd=self.root, env=os.environ | {"PYTHONPATH": str(self.root)},
            capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout[-4000:]}{done.stderr[-2000:]}"

    def assert_green(self, *tests: str) -> None:
        """What CONTRIBUTING.md and the page ask for before a commit."""
        self.run("-m", "ruff", "check", ".")
        self.run("-m", "mypy")
        self.run(str(Path(sys.executable).parent / "lint-imports"))
        self.run("-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/house", *tests)


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    return Tree(tmp_path / "longreach")


def blocks(name: str, language: str = "python") -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page(f"how_to/{name}.md"), re.DOTALL)


REACH_TEST = '''"""The arm's reach is told."""

from httpx import ASGITransport, AsyncClient

from tests.vision_pc.synthetic_station import bench
from vision_pc.shell.rest.api import create_app


async def test_the_reach_is_that_of_the_drawing() -> None:
    async with bench() as made:
        app = create_app(made.station, made.operations)
        async with AsyncClient(transport=ASGITransport(app), base_url="http://test") as client:
            boom = made.station.dimensions
            answer = (await client.get("/arm")).json()
    assert answer == {"reach_m": boom.boom + boom.forearm + boom.wrist_to_tool}
'''


def test_a_route_is_added(tree: Tree) -> None:
    (block,) = blocks("add_a_route")
    api = "vision_pc/shell/rest/api.py"
    tree.put(api, f"{block[block.index('def ') :]}\n\n", before="def _add_looks(")
    tree.put(api, "    add_reach(app, application)\n", after="    add_metrics(app, application)\n")
    tree.run("-m", "tests.vision_pc.test_openapi")
    tree.put("tests/vision_pc/shell/test_reach.py", REACH_TEST)
    tree.put("docs/rest.md", "`GET /arm` says how far the arm reaches, m.\n\n", before="## Idempotency keys")
    tree.put("CHANGELOG.md", "- `GET /arm` says how far the arm reaches.\n", after="### Changed\n\n")
    tree.assert_green("tests/vision_pc/shell/test_reach.py", "tests/vision_pc/test_openapi.py")


SEEN = '''"""A wobbling encoder is seen."""

from pathlib import Path

import pytest

from plant_emulator.core.faults.kinds import EncoderWobble


def test_the_wobble_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    {}
    assert 206 <= int(capsys.readouterr().out) <= 211
'''
DRAWN = "45.0 <= settings.plant.oil.temperature_degc <= 65.0 and settings.plant.oil.ambient_degc == 35.0"


def test_a_disturbance_is_added(tree: Tree) -> None:
    drawn, kind, branch, seen = blocks("add_a_disturbance")
    (scenario,) = blocks("add_a_disturbance", "yaml")
    tree.put("configs/scenarios/hot_oil.yaml", scenario)
    tree.run("-c", f"{drawn}\nassert {DRAWN}")
    kinds, effects = (f"plant_emulator/core/faults/{name}.py" for name in ("kinds", "effects"))
    tree.put(kinds, f"{kind}\n\n", before="class PayloadDrop(")
    tree.put(kinds, "    | EncoderWobble\n", after="    | EncoderBias\n")
    tree.put(effects, branch, before="        elif isinstance(fault, OwnFault):\n            shift += ")
    tree.put(effects, "    EncoderWobble,\n", after="    EncoderStuck,\n")
    row = "| `encoder_wobble` | `joint`, `angle_mrad`, `period_s` (1) | the count swings about the truth |\n"
    tree.put("docs/faults.md", row, before="| `payload_drop` |")
    every = '    {"kind": "encoder_wobble", "joint": "lift", "angle_mrad": 10.0},\n'
    tree.put("tests/plant_emulator/faults/test_faults.py", every, before='    {"kind": "supply_lost"},\n')
    imports, _, body = seen.partition("\n\n")
    test = SEEN.replace("import pytest\n", f"import pytest\n\n{imports}")
    tree.put("tests/plant_emulator/faults/test_wobble.py", test.format(body.strip().replace("\n", "\n    ")))
    tree.run("-m", "ruff", "check", "-q", "--fix", "--select", "I", "tests/plant_emulator/faults")
    tree.assert_green("tests/plant_emulator/faults")
    assert "It prints about 209" in page("how_to/add_a_disturbance.md")


def test_a_program_is_added(tree: Tree) -> None:
    coroutine, row, run_it, _ = blocks("add_a_program")
    programs = "vision_pc/application/programs.py"
    tree.put("run_it.py", run_it)
    tree.put("there_and_back.py", f"{coroutine}\n\n{row}")
    tree.run("run_it.py")
    (tree.root / "run_it.py").unlink()
    (tree.root / "there_and_back.py").rename(tree.root / "vision_pc" / "application" / "there_and_back.py")
    line = "from vision_pc.application.there_and_back import THERE_AND_BACK\n"
    tree.put(programs, line, before="from vision_pc.application.visit import")
    tree.put(programs, "    THERE_AND_BACK,\n", before="    VISIT,\n    *HAND_EYE")
    tree.run("-m", "tools.pages")
    tree.run("-m", "tests.vision_pc.test_openapi")
    tree.assert_green("tests/tools/test_generated_pages.py", "tests/vision_pc/test_openapi.py")


def test_a_program_is_served(tmp_path: Path) -> None:
    coroutine, row, _, serve_it = blocks("add_a_program")
    (tmp_path / "there_and_back.py").write_text(f"{coroutine}\n\n{row}", encoding="utf-8")
    (tmp_path / "serve_it.py").write_text(serve_it, encoding="utf-8")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = [sys.executable, str(tmp_path / "serve_it.py"), "--set", f"vision.api.port={port}"]
    with subprocess.Popen(words, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}) as served:
        with httpx.Client(transport=httpx.HTTPTransport(retries=8)) as client:
            paths = client.get(f"http://127.0.0.1:{port}/openapi.json").json()["paths"]
        served.terminate()
    assert served.returncode == 0
    assert "/operations/there-and-back" in paths


def test_an_arm_is_added(tree: Tree) -> None:
    tree.run("-m", "longreach", "arm", "new", "my_arm", "--like", "long_crane")
    tree.run("-m", "longreach", "arm", "check", "my_arm")
    tree.run("-m", "longreach", "arm", "draw", "my_arm", "--out", "my_arm.png")
    tree.assert_green("tests/testbed/arms")
