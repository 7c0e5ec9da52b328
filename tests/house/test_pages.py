"""Pages against one another and the code: readers, words, steps, tables, equations."""

import functools
import importlib.util
import inspect
import os
import re
from pathlib import Path
from typing import NamedTuple

from conformance.records import COUPLER_STEPS, REFERENCE_STEPS
from conformance.runner import coupler_cases, reference_cases
from controller.core.group_states import TRANSITIONS, Stimulus
from controller.core.supervision import REACTIONS
from protocol.axes_group import Mode
from protocol.faults import FAULT_TEXTS, Reason, Severity
from tests.support.pages import page
from tests.support.paths import DOCS, ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")]


def test_every_decision_is_in_the_index() -> None:
    records = {path.name for path in (ROOT / "docs" / "decisions").glob("[0-9]*.md")}
    index = (ROOT / "docs" / "decisions" / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\]\(([0-9][^)]+)\)", index)) == records


READ = sorted({*DOCS.glob("*.md"), *DOCS.glob("how_to/*.md")} - {DOCS / "README.md"})
EVERYBODY = "Everybody"


@functools.cache
def readers() -> dict[Path, list[str]]:
    """Of every page that docs/README.md links, the headings under which it does, without what they do."""
    found: dict[Path, list[str]] = {}
    for section in (DOCS / "README.md").read_text(encoding="utf-8").split("\n## ")[1:]:
        who = section.partition("\n")[0].partition(":")[0].strip()
        for target in re.findall(r"\]\(([^)#]+\.md)(?:#[^)]*)?\)", section):
            known = found.setdefault((DOCS / target).resolve(), [])
            if who not in known:
                known.append(who)
    return found


def in_a_sentence(who: str) -> str:
    """``who`` as it stands in the middle of one."""
    return who if who.startswith("PLC") else who.lower()


def line_for(page: Path) -> str:
    """What stands under the title of ``page``."""
    who = readers().get(page.resolve(), [])
    assert who, f"docs/README.md has no link to {page.relative_to(DOCS)}"
    told = "everybody" if EVERYBODY in who else ", ".join(map(in_a_sentence, who))
    glossary = os.path.relpath(DOCS / "glossary.md", page.parent)
    words = "" if page.name == "glossary.md" else f" Words: [glossary]({glossary})."
    return f"For: {told}.{words}"


def test_the_line_under_the_title_names_the_readers() -> None:
    heads = {page: page.read_text(encoding="utf-8").split("\n", 4)[:4] for page in READ}
    assert [page for page, head in heads.items() if not head[0].startswith("# ")] == []
    under = {page: ["", line_for(page), ""] for page in READ}
    assert {page: head[1:] for page, head in heads.items()} == under


def test_there_are_pages_for_every_reader() -> None:
    told = {who for found in readers().values() for who in found}
    assert told == {"Researcher", "PLC engineer", "Vision engineer", "Operator", EVERYBODY}
    assert len(READ) > 30


NAMED = re.findall(r"`([a-z_]+/[\w/]+\.py)(?:: (\w+))?`", page("glossary.md"))
_PATH = re.compile(r"`([\w./-]+?)/?(?::[^`]*)?`")
MADE_BY_THE_READER = {
    "there_and_back.py", "run_it.py", "serve_it.py", "my_crane.py", "configs/scenarios/hot_oil.yaml",
    "configs/arms/my_arm", "laboratory/experiments/robustness/sag.py",
}  # fmt: skip
MADE_BY_A_RUN = {f"{name}.mcap" for name in ("truth", "controller", "vision")}


def test_every_path_that_a_page_names_is_there() -> None:
    tops = {path.name for path in ROOT.iterdir() if path.is_dir()} - {"runs", "dist"}
    tops = {name for name in tops if not name.startswith(".")}
    known = [
        f"/{path.relative_to(ROOT)}" for name in tops for path in (ROOT / name, *(ROOT / name).rglob("*"))
    ]
    known += [f"/{path.name}" for path in ROOT.iterdir()]
    named = {(at, name) for at in {*PAGES, *READ} for name in _PATH.findall(at.read_text(encoding="utf-8"))}
    paths = {
        (at, n) for at, n in named if n.endswith((".py", ".st")) or ("/" in n and n.split("/")[0] in tops)
    }
    assert len(paths) > 200
    expected = {
        (at, n) for at, n in paths if n not in MADE_BY_THE_READER and Path(n).name not in MADE_BY_A_RUN
    }
    gone = {f"{at.name}: {n}" for at, n in expected if not any(k.endswith(f"/{n}") for k in known)}
    assert gone == set()


def test_every_module_that_a_page_runs_is_there() -> None:
    texts = {at: at.read_text(encoding="utf-8") for at in {*PAGES, *READ} if at.name != "CHANGELOG.md"}
    named = {
        (at.name, name) for at, text in texts.items() for name in re.findall(r"python -m ([\w.]+)", text)
    }
    assert len(named) > 15
    assert {(at, name) for at, name in named if importlib.util.find_spec(name.rstrip(".")) is None} == set()


def test_what_the_glossary_names_is_defined_there() -> None:
    assert len(NAMED) > 35
    for file, name in NAMED:
        text = (ROOT / file).read_text(encoding="utf-8")
        assert not name or re.search(
            rf"^(?:async def|def|class) {name}\b|^{name}\b.*=", text, re.MULTILINE
        ), name


def test_steps_are_cases_each_once_and_those_that_move_come_behind_those_that_do_not() -> None:
    for steps, cases in ((REFERENCE_STEPS, reference_cases()), (COUPLER_STEPS, coupler_cases())):
        by_number = {case.number: case for case in cases}
        numbers = [step.number for step in steps]
        assert len(set(numbers)) == len(numbers)
        assert set(numbers) <= set(by_number)
        optional = [bool(by_number[number].needs) for number in numbers]
        assert optional == sorted(optional)
        assert all(step.hint.endswith(".") for step in steps)


PAGE = (ROOT / "docs" / "controller.md").read_text(encoding="utf-8")


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


def _between(mark: str) -> str:
    match = re.search(rf"<!-- {mark} -->\n(.*?)<!-- /{mark} -->", PAGE, re.DOTALL)
    assert match is not None
    return match.group(1).strip()


def state_table() -> str:
    """The page's table of states, from the transition table."""
    lines = [f"| stimulus | {' | '.join(_words(mode.name) for mode in Mode)} |"]
    lines.append("| --- " * (len(Mode) + 1) + "|")
    for stimulus in Stimulus:
        cells = []
        for mode in Mode:
            after = TRANSITIONS[mode, stimulus]
            reason = "" if after.reason is Reason.ACCEPTED else f" ({_words(after.reason.name)})"
            cells.append(f"{'–' if after.mode is mode else _words(after.mode.name)}{reason}")
        lines.append(f"| {stimulus.name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def fault_table() -> str:
    """The page's table of faults, with the words of the written protocol."""
    lines = ["| fault | when | reaction |", "| --- | --- | --- |"]
    for code, reaction in REACTIONS.items():
        how = "stop" if reaction.severity is Severity.STOP else "emergency"
        lines.append(f"| `{code.name}` | {FAULT_TEXTS[code]} | {how} |")
    return "\n".join(lines)


def test_the_table_of_states_is_the_transition_table() -> None:
    assert _between("states") == state_table()


def test_the_table_of_faults_is_the_supervision_s() -> None:
    assert _between("faults") == fault_table()


EQUATIONS = ROOT / "docs" / "equations.md"
_BELOW = {"Hua": "vision_pc/core/hand_eye/"}
_ROW = re.compile(r"^\| \((\d+)\)(?: to \((\d+)\))? \| [^|]+ \| `([^`]+)` \| ([^|]+) \|$")


class Row(NamedTuple):
    """One equation of the page, or several that one function holds."""

    paper: str
    first: int
    last: int
    file: str
    function: str


def _rows() -> list[Row]:
    rows, paper = [], ""
    for line in EQUATIONS.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            paper = line.split()[1]
        match = _ROW.match(line)
        if match is None:
            continue
        first, last, file, functions = match.groups()
        where = file if "_pc/" in file or paper == "Mäkinen" else _BELOW[paper] + file
        names = re.findall(r"`([^`]+)`", functions)
        rows += [Row(paper, int(first), int(last or first), where, name) for name in names]
    return rows


def _numbers(text: str) -> set[int]:
    """Every number that ``text`` names: (7), eq. 26, (9)-(16), (17) to (24)."""
    named = {int(n) for n in re.findall(r"\((\d{1,2})\)", text)}
    named |= {int(n) for n in re.findall(r"eq\. (\d{1,2})\b", text)}
    for a, b in re.findall(r"\((\d{1,2})\)(?:-| to )\((\d{1,2})\)", text):
        named |= set(range(int(a), int(b) + 1))
    return named


def test_the_function_of_each_equation_exists_and_names_its_number() -> None:
    missing = {}
    for row in _rows():
        found = importlib.import_module(row.file.removesuffix(".py").replace("/", "."))
        for part in row.function.split("."):
            found = getattr(found, part)
        source = inspect.getsource(getattr(found, "py_func", found))
        missing[row] = set(range(row.first, row.last + 1)) - _numbers(source)
    assert [(row, numbers) for row, numbers in missing.items() if numbers] == []
    assert len(missing) > 25


def test_every_equation_of_the_positioning_paper_has_a_row() -> None:
    named = {n for row in _rows() if row.paper == "Mäkinen" for n in range(row.first, row.last + 1)}
    assert named == set(range(1, 26))
