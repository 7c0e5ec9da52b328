"""What commands print, on pages and in the notebook: ``python -m tools.printed`` writes it anew.

On a page the ``text`` block behind a command shows lines that the command prints. The tool runs the command
and puts its numbers into these lines, with as many decimals as the page has. Real-time runs are left alone.

``--check`` writes nothing: exit status 1 where a digit differs, or a standard deviation (after ``±``) by over
a tenth. ``--quick`` leaves out what runs longer than 20 s, which tests/longreach checks.

A lockstep run is the same on one processor. On others its first looks are the same to the last digit printed;
where a motion ends is not. So the tutorial names the processor of its numbers, and the check on others allows
1 mm. A figure that should be the same everywhere and is not gets fewer decimals: remove them on the page.
"""

import ast
import json
import os
import re
import subprocess
import sys
import tempfile
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding

ROOT = Path(__file__).parents[1]
TUTORIAL = ROOT / "docs" / "tutorial.md"
PAGES = (ROOT / "README.md", TUTORIAL, *sorted((ROOT / "docs" / "how_to").glob("*.md")))
NOTEBOOK = ROOT / "examples" / "notebooks" / "first_run.ipynb"
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
_FENCED = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
_SIGMAS = re.compile(r"± \d+\.\d+|<th>1 σ.*?</tr>")
_PROCESSOR = re.compile(r"(?<=processor `)[\w-]+(?=`)")
_REAL_TIME, _LONG = ("make ", "docker ", "longreach up"), "longreach demo"


class Block(NamedTuple):
    """A block in ``language`` (sh, python), and the lines that the page says it prints."""

    language: str
    text: str
    printed: tuple[str, ...]


def blocks(page: str) -> list[Block]:
    """The blocks of a page that can be run, in order, each with the ``text`` block behind it, if any."""
    found: list[Block] = []
    for language, inside in _FENCED.findall(page):
        if language == "text":
            assert found, f"nothing is run before {inside!r}"
            found[-1] = found[-1]._replace(printed=tuple(inside.splitlines()))
        else:
            found.append(Block(language, inside, ()))
    return found


def output(block: Block, folder: Path) -> str:
    """What ``block`` prints, run in ``folder``. Raises CalledProcessError where its exit status is not 0."""
    shell = ["bash", "-euo", "pipefail", "-c"] if block.language == "sh" else [sys.executable, "-c"]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    surroundings = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [*shell, block.text], cwd=folder, env=surroundings, stdout=subprocess.PIPE, text=True, check=True
    ).stdout


def renewed(line: str, seen: str) -> str:
    """``line`` with the numbers of the first place in ``seen`` that has its words, rounded as ``line`` is.

    Blanks count as one, and as none within brackets. Raises ValueError where the words are nowhere.
    """
    pattern = f"({NUMBER.pattern})".join(re.escape(word) for word in NUMBER.split(line))
    found = re.search(pattern, re.sub(r"(?<=\[) | (?=\])", "", " ".join(seen.split())))
    if found is None:
        raise ValueError(f"nothing prints {line!r}, but {seen[-2000:]}")
    numbers = iter(found.groups())
    return NUMBER.sub(lambda shown: _rounded(next(numbers), shown[0]), line)


def _rounded(number: str, like: str) -> str:
    decimals = len(like.partition(".")[2])
    return f"{float(number):{'+' if number[0] == '+' else ''}.{decimals}f}"


def on_that_processor() -> bool:
    """Return True if this is the processor that the tutorial names."""
    named = _PROCESSOR.findall(TUTORIAL.read_text(encoding="utf-8"))
    return named == [llvmlite.binding.get_host_cpu_name()]


def agree(shown: str, made: str, exact: bool) -> bool:
    """Return True if the texts have the same words and numbers, standard deviations within a tenth.

    Not ``exact``: numbers within 1 and a hundredth.
    """
    sigmas = [range(*found.span()) for found in _SIGMAS.finditer(shown)]
    pairs = zip(NUMBER.finditer(shown), NUMBER.findall(made), strict=True)
    return NUMBER.split(shown) == NUMBER.split(made) and all(
        abs(float(old[0]) - float(new)) <= _allowed(float(new), any(old.start() in s for s in sigmas), exact)
        for old, new in pairs
    )


def _allowed(number: float, is_sigma: bool, exact: bool) -> float:
    if is_sigma:
        return 0.1 * number
    return 0.0 if exact else 1.0 + 0.01 * abs(number)


def page_lines(page: Path, quick: bool) -> Iterator[tuple[str, str]]:
    """Each line of ``page`` that a command prints, and as the command prints it now."""
    for block in blocks(page.read_text(encoding="utf-8")):
        left_out = block.text.startswith(_REAL_TIME) or (quick and block.text.startswith(_LONG))
        if block.printed and not left_out:
            with tempfile.TemporaryDirectory() as folder:
                seen = output(block, Path(folder))
            yield from ((line, renewed(line, seen)) for line in block.printed)


def notebook() -> tuple[dict[str, Any], dict[str, Any]]:
    """The notebook as it is, and with the outputs of a run from top to bottom."""
    old, new = (json.loads(NOTEBOOK.read_text(encoding="utf-8")) for _ in range(2))
    names: dict[str, Any] = {}
    for cell in new["cells"]:
        if cell["cell_type"] == "code":
            *before, last = ast.parse("".join(cell["source"])).body
            assert isinstance(last, ast.Expr)
            exec(compile(ast.Module(before, []), "notebook", "exec"), names)
            value = eval(compile(ast.Expression(last.value), "notebook", "eval"), names)
            cell["outputs"][0]["data"] = _shown(value)
    return old, new


def _shown(value: Any) -> dict[str, Any]:
    """What a notebook keeps of a cell's value: text, and a picture where it has one."""
    png = getattr(value, "_repr_png_", lambda: None)()
    return {"text/plain": [repr(value)]} | ({"image/png": b64encode(png).decode()} if png else {})


def stale_cells() -> list[str]:
    """The outputs of the notebook that a run does not make, pictures not compared."""
    old, new = (
        [
            f"{kind} {'' if kind == 'image/png' else ''.join(text)}"
            for cell in book["cells"]
            for out in cell.get("outputs", ())
            for kind, text in out["data"].items()
        ]
        for book in notebook()
    )
    pairs = zip(old, new, strict=True)
    exact = on_that_processor()
    return [f"{shown}, comes {now}" for shown, now in pairs if not agree(shown, now, exact)]


def stale(page: Path, quick: bool) -> list[str]:
    """What ``page`` says that a command prints, and it does not."""
    exact = quick or on_that_processor()
    lines = page_lines(page, quick)
    return [f"{page.name}: {line}, comes {now}" for line, now in lines if not agree(line, now, exact)]


def write() -> int:
    """Write every page's lines and the notebook's outputs anew. Return 0, the exit status."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for line, now in page_lines(page, quick=False):
            text = text.replace(f"\n{line}\n", f"\n{now}\n", 1)
        page.write_text(_PROCESSOR.sub(llvmlite.binding.get_host_cpu_name(), text), encoding="utf-8")
    NOTEBOOK.write_text(json.dumps(notebook()[1], indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return 0


def check(quick: bool) -> int:
    """Exit status: 1 where something is stale, with a line for each."""
    found = [line for page in PAGES for line in stale(page, quick)] + ([] if quick else stale_cells())
    print(*found, f"{len(found)} stale lines of pages", sep="\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(check("--quick" in sys.argv) if "--check" in sys.argv else write())
