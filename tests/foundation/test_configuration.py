"""Overrides from the command line, and the hash by which both sides know the arm."""

import re
from pathlib import Path
from typing import Annotated

import pytest
from pydantic import AfterValidator

from foundation.configuration import (
    StrictModel,
    beside,
    configuration_hash,
    load,
    merged,
    parse_overrides,
    read_yaml,
    validated,
)
from foundation.live import LiveSettings
from protocol.errors import ConfigurationError


class Link(StrictModel):
    length_m: float
    tags: tuple[str, ...] = ()


class Arm(StrictModel):
    reach_m: float
    links: tuple[Link, ...] = ()


def cause_of_overrides(*assignments: str) -> str:
    with pytest.raises(ConfigurationError) as caught:
        parse_overrides(assignments)
    assert "\n" not in str(caught.value)
    return caught.value.cause


def test_the_first_part_names_the_file_and_the_rest_the_key() -> None:
    assert parse_overrides(
        [
            "plant.valves.deadband=0.03",
            "plant.valves.lag_ms = 12",
            "plant.seed=7",
            "vision.look.frames=[1, 2]",
        ]
    ) == {
        "plant": {"valves": {"deadband": 0.03, "lag_ms": 12}, "seed": 7},
        "vision": {"look": {"frames": [1, 2]}},
    }


def test_values_are_yaml() -> None:
    parsed = parse_overrides(["a.text=on the wall", "a.none=", "a.flag=true", "a.map={x: 1}", "a.sum=1=2"])
    assert parsed == {"a": {"text": "on the wall", "none": None, "flag": True, "map": {"x": 1}, "sum": "1=2"}}


@pytest.mark.parametrize(
    "assignment", ["", "plant", "plant=1", "plant.seed", "=1", "plant.=1", ".seed=1", "a..b=1"]
)
def test_an_assignment_needs_a_file_a_key_and_a_value(assignment: str) -> None:
    assert cause_of_overrides(assignment) == "configuration.bad_override"


def test_a_value_that_is_not_yaml_is_refused() -> None:
    for value in ("[1,", "\udcff", "!!map [1]"):  # the second: a byte that is no UTF-8
        assert cause_of_overrides(f"plant.seed={value}") == "configuration.not_yaml"
    assert cause_of_overrides("plant.map={a: 1, a: 2}") == "configuration.duplicate_key"


@pytest.mark.parametrize(
    "assignments", [("a.b=1", "a.b=2"), ("a.b=1", "a.b.c=2"), ("a.b.c=1", "a.b=2"), ("a.b={c: 1}", "a.b.c=2")]
)
def test_assignments_that_contradict_each_other_are_refused(assignments: tuple[str, ...]) -> None:
    assert cause_of_overrides(*assignments) == "configuration.contradiction"


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("reach_m: 5\nrech_m: 4\n", "configuration.unknown_key"),
        ("links: []\n", "configuration.missing"),
        ("reach_m: .nan\n", "configuration.finite_number"),
        ("reach_m: 5\nreach_m: 4\n", "configuration.duplicate_key"),
        ("- 5\n", "configuration.not_a_mapping"),
        ("reach_m: [5\n", "configuration.not_yaml"),
    ],
)
def test_each_fault_of_a_file_has_its_cause(tmp_path: Path, text: str, cause: str) -> None:
    refused_for(tmp_path, text, cause)


def refused_for(directory: Path, text: str, cause: str) -> str:
    """How the arm's file is refused: in no word of a parser, schema or interpreter."""
    (directory / "arm.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        load(Arm, directory / "arm.yaml")
    assert caught.value.cause == cause
    words = str(caught.value)
    assert not re.search(
        r"\n|Input|Field|tuple|boolean|constructor|token|scanning|unhashable|tag:|None|True", words
    )
    return words


@pytest.mark.parametrize(
    ("line", "cause", "told"),
    [
        ("links: !!set {a}", "not_yaml", "line 2, column 8: such a tag is not read"),
        ("links: !!binary aGk=", "not_yaml", "line 2, column 8: such a tag is not read"),
        ("links: !!map [1]", "not_yaml", "line 2, column 8: expected a mapping node"),
        ("links: !mine 5", "not_yaml", "line 2, column 8: such a tag is not read"),
        ("links: !!bool x", "not_yaml", "line 2, column 8: 'x' is no number"),
        ("links: !!bool 1", "tuple_type", "links = 1: a list is wanted"),
        ("links: !!float", "not_yaml", "line 2, column 8: '' is no number"),
        ("links: !!timestamp x", "not_yaml", "line 2, column 8: such a tag is not read"),
        ("links:\n\t- a", "not_yaml", "lines are set in by spaces, no tabs"),
        ("links: a: b", "not_yaml", "line 2, column 9: a second colon"),
        ("links: *a", "not_yaml", "line 2, column 8: no such anchor"),
        ("[a]: 1", "not_yaml", "line 2, column 1, in what begins in line 1: a key is one text"),
        ("links: 'a", "not_yaml", "line 3, column 1, in what begins in line 2: a quote is not closed"),
        ("reach_m: 4", "duplicate_key", "line 2: key 'reach_m' is written twice"),
        ("links: on", "tuple_type", "links = true: a list is wanted"),
        ("links: [{length_m: yes}]", "number", "links.0.length_m = true: a number in decimal digits"),
        ("links: [{length_m: }]", "float_type", "links.0.length_m = null: a number in decimal digits"),
        ("links: [{}]", "missing", "links.0.length_m: a value is wanted"),
        ("links: [{length_m: 1, tags: [no]}]", "string_type", "tags.0 = false: text is wanted, in quotes"),
        ("true: 1", "invalid_key", "a key is text"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_file_is_said_in_words_for_who_wrote_it(
    tmp_path: Path, line: str, cause: str, told: str
) -> None:
    assert told in refused_for(tmp_path, f"reach_m: 5\n{line}\n", f"configuration.{cause}")


def test_keys_are_merged_in_beneath_those_of_the_mapping_and_dates_are_text(tmp_path: Path) -> None:
    link = "<<: *link, tags: [2026-12-01, =]"
    (tmp_path / "arm.yaml").write_text(
        f"reach_m: 5\nlinks: [&link {{length_m: 1.5, tags: [a]}}, {{{link}}}]\n"
    )
    assert load(Arm, tmp_path / "arm.yaml").links == (
        Link(length_m=1.5, tags=("a",)),
        Link(length_m=1.5, tags=("2026-12-01", "=")),
    )


@pytest.mark.parametrize("host", ["127.0.0.1:47000", "http://plc", "plc ", "[::1]", "", "plc/api"])
def test_a_host_is_a_name_or_an_address_alone(host: str) -> None:
    with pytest.raises(ConfigurationError, match="no scheme, port or brackets"):
        validated(LiveSettings, {"host": host}, "test")


@pytest.mark.parametrize("host", ["plc", "plc.local.", "10.0.0.7", "::1", "fe80::1%eth0"])
def test_a_host_may_be_written_so(host: str) -> None:
    assert validated(LiveSettings, {"host": host}, "test").host == host


def test_a_file_in_another_encoding_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.yaml").write_bytes("reach_m: 5  # Länge".encode("latin-1"))
    with pytest.raises(ConfigurationError, match="byte 15") as caught:
        read_yaml(tmp_path / "arm.yaml")
    assert caught.value.cause == "configuration.not_yaml"


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"arm\.yaml") as caught:
        read_yaml(tmp_path / "arm.yaml")
    assert caught.value.cause == "configuration.unreadable"


def test_merging_goes_key_by_key_and_replaces_lists() -> None:
    base = {"a": {"b": 1, "c": [1, 2]}, "d": 4}
    assert merged(base, {"a": {"c": [3]}, "e": 5}) == {"a": {"b": 1, "c": [3]}, "d": 4, "e": 5}
    assert base == {"a": {"b": 1, "c": [1, 2]}, "d": 4}


def test_the_hash_follows_the_values_and_nothing_else() -> None:
    arm = validated(Arm, {"reach_m": 5, "links": [{"length_m": 1.0, "tags": ["a"]}]}, "test")
    same = validated(Arm, {"links": [{"tags": ["a"], "length_m": 1}], "reach_m": 5.0}, "test")
    other = validated(Arm, {"reach_m": 5.0, "links": [{"length_m": 1.0, "tags": ["b"]}]}, "test")
    assert configuration_hash(arm) == configuration_hash(same) != configuration_hash(other)
    assert 0 < configuration_hash(arm) < 2**64
    # The value itself is on the wire: it must be the same on every machine.
    assert configuration_hash(Link(length_m=1.5)) == 0x78B3D2F0E9567012


class Fitted(StrictModel):
    drawing: Annotated[Path, AfterValidator(beside)]


def test_a_named_file_is_beside_its_configuration_or_below_it_or_else_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    below, above, here = (tmp_path / name for name in ("below", "above", "here"))
    for directory in (below, above, here):
        directory.mkdir()
    (below / "machine.yaml").write_text("drawing: front.png\n")
    (above / "base.yaml").write_text("over: ../below\n")
    monkeypatch.chdir(here)

    def found() -> Path:
        return load(Fitted, above / "machine.yaml").drawing

    assert found() == above / "front.png", "nowhere: where it is wanted"
    for directory in (here, below, above):
        (directory / "front.png").touch()
        assert found().resolve() == directory / "front.png"
    assert (
        load(Fitted, above / "machine.yaml", {"drawing": str(here / "front.png")}).drawing
        == here / "front.png"
    )
