"""The house keeps its measures: no circle between rooms, no crowded folder, few long or wide functions."""

import re

import pytest

from tests.house import measures

ROOMS = measures.rooms(measures.ROOT)
# What the house may weigh. Lowered with every change that takes something away; raised only by a change that
# brings a capability, by what that needs, with the reason in its commit.
BUDGET = {
    "lines of conformance": 10_340,
    "lines of laboratory": 15_891,
    "lines of product": 84_456,
    "modules": 680,
    "lines of source": 111_566,
    "lines of tests": 64_772,
    "words of pages": 51_015,
    "words of the README": 700,
    "configuration keys": 654,
    "constants of vision without a tag": 375,
    "constants of the controller without a tag": 21,
}


@pytest.fixture(scope="module")
def every() -> list[measures.Module]:
    return measures.modules(measures.ROOT)


def test_the_house_weighs_no_more_than_its_budget() -> None:
    weighs = measures.mass(measures.ROOT)
    assert weighs.keys() == BUDGET.keys()
    over = [
        f"{what}: {count}, at most {BUDGET[what]}" for what, count in weighs.items() if count > BUDGET[what]
    ]
    assert over == [], "take something away; BUDGET above is raised for a new capability alone"


def test_no_folder_has_more_than_twenty_rooms() -> None:
    assert {folder: count for folder, count in ROOMS.items() if count > measures.MAX_ROOMS} == {}


@pytest.mark.slow("every source is parsed")
def test_no_modules_and_no_rooms_of_any_folder_import_in_a_circle(every: list[measures.Module]) -> None:
    arrows = measures.imports(every)
    assert measures.circles(arrows) == []
    for folder in ("", *ROOMS):
        inside = measures.arrows_between_rooms(folder.replace("/", "."), arrows)
        assert measures.circles(inside) == [], folder


def test_no_public_class_name_is_used_twice(every: list[measures.Module]) -> None:
    assert measures.names_used_twice(every) == {}


def test_no_function_is_long_and_only_a_named_kernel_takes_many_parameters(
    every: list[measures.Module],
) -> None:
    """A compiled kernel neither allocates nor takes a bundle of arrays apart: it gets them one by one."""
    long = [f"{named.place}: {named.count} lines" for named in measures.long_functions(every)]
    wide = [f"{named.place}: {named.count} parameters" for named in measures.many_parameters(every)]
    assert long == [], f"at most {measures.MAX_LINES}, the docstring not counted"
    assert [one for one in wide if "booked_steps" not in one] == [], f"at most {measures.MAX_PARAMETERS}"


def test_every_test_that_is_marked_slow_says_why() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in (measures.ROOT / "tests").rglob("test_*.py")}
    marks = {path: re.findall(r"pytest\.mark\.slow\b(.*)", text) for path, text in texts.items()}
    assert any(marks.values())
    unsaid = [path for path, found in marks.items() for rest in found if not re.match(r"\([\"']\w+", rest)]
    assert unsaid == []


def test_no_name_of_the_makefile_is_given_twice() -> None:
    """The later one would win everywhere: `make clean` once named tests by the name of an environment."""
    lines = (measures.ROOT / "Makefile").read_text().splitlines()
    names = [match[1] for line in lines if (match := re.match(r"(\w+)\s*[:?]?=", line))]
    assert names, "no assignment was found"
    assert [name for name in names if names.count(name) > 1] == []
