"""All ways of writing a number, into all kinds of fields, by all entrances: right, or refused by its name."""

import itertools
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from foundation.configuration import merged, parse_yaml, read_yaml, validated
from testbed.scenarios.scenario import MODELS, fault_orders
from tests.foundation.written_numbers import (
    ENTRANCES,
    NO_JSON,
    NUMERIC,
    SHAPES,
    WRITINGS,
    Refused,
    answered,
    post,
    wrong,
)
from tests.support.paths import CONFIGS
from vision_pc.application.bodies import LookBody, MoveBody, RequestBody


@pytest.mark.parametrize("entrance", ENTRANCES, ids=lambda one: one.__name__)
@pytest.mark.parametrize("kind", NUMERIC)
def test_a_number_is_right_or_refused_by_its_name(
    kind: str, entrance: Callable[[str, str, Path], Any], tmp_path: Path
) -> None:
    shape = SHAPES.get(kind, "{0}")
    words = [
        wrong(kind, one, entrance(kind, shape.format(one.text), tmp_path))
        for one in WRITINGS
        # What makes two items of one, or a row, is another kind of mistake in a row.
        if (kind not in SHAPES and kind != "one_of") or ("," not in one.text and one.text[:1] != "[")
    ]
    assert not [each for each in words if each]
    assert len(words) > 1_000


@pytest.mark.parametrize("entrance", ENTRANCES, ids=lambda one: one.__name__)
def test_truth_values_and_texts_are_no_numbers_and_numbers_are_neither(
    entrance: Callable[[str, str, Path], Any], tmp_path: Path
) -> None:
    for one in WRITINGS:
        flag, text, device = (entrance(key, one.text, tmp_path) for key in ("flag", "text", "device"))
        said = one.text.lower()
        assert isinstance(flag, Refused) or (flag is (said in ("true", "yes", "on")) and one.value is None), (
            one
        )
        bare = one.text.removeprefix("!!str ").strip("\"'")
        assert isinstance(text, Refused) or text == bare, one
        assert isinstance(device, Refused) or device in (bare, one.value and int(one.value)), one


WRONG = ("true", '"5"', "010", "1:30", ".nan", "1e999")


def leaves(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The places of all numbers in what a YAML file holds."""
    rows = data.items() if isinstance(data, Mapping) else enumerate(data) if isinstance(data, list) else ()
    for key, below in rows:
        yield from leaves(below, (*path, key))
    if isinstance(data, int | float) and not isinstance(data, bool):
        yield path


def replaced(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    """``data`` with another value at ``path``."""
    if not path:
        return value
    key, *rest = path
    if isinstance(data, list):
        return [*data[:key], replaced(data[key], tuple(rest), value), *data[key + 1 :]]
    return merged(data, {}) | {key: replaced(data[key], tuple(rest), value)}


@pytest.mark.parametrize("name", [name for name in MODELS if (CONFIGS / f"{name}.yaml").is_file()])
def test_each_number_of_each_configuration_takes_numbers_alone(name: str) -> None:
    data = read_yaml(CONFIGS / f"{name}.yaml")
    validated(MODELS[name], data, name, CONFIGS)
    for path, written in itertools.product(leaves(data), WRONG):
        if path[-1] == "device":  # a number, or the name of a camera
            continue
        spoilt = replaced(data, path, parse_yaml(written, name))
        found = answered(lambda given=spoilt: validated(MODELS[name], given, name, CONFIGS))
        assert isinstance(found, Refused), f"{name}: {path} = {written}"


FAULTS = {
    "payload_change": ("mass_kg", 0.0, 1000.0, float),
    "object_moves": ("speed_mm_s", -100.0, 100.0, float),
    "marker_covered": ("marker_id", 0, 999, int),
}


def faults_by(key: str, kind: str, written: str) -> Iterator[Any]:
    """A fault's number by the command line and by the body of the emulator's API."""
    yield answered(lambda: getattr(fault_orders([f"{kind},{key}={written}"])[0].fault, key))
    found = post("/faults", f'{{"fault": {{"kind": "{kind}", "{key}": {written}}}}}')
    yield found if isinstance(found, Refused) else found["fault"][key]


@pytest.mark.parametrize("kind", FAULTS)
def test_an_order_breaks_what_is_written_or_nothing(kind: str) -> None:
    key, low, high, number = FAULTS[kind]
    for one in WRITINGS:
        for found in faults_by(key, kind, one.text):
            if isinstance(found, Refused):
                inside = one.plain and one.value is not None and low <= one.value <= high
                inside &= not NO_JSON.search(one.text)
                assert not inside or (number is int and one.value % 1 != 0), (one, found)
            else:
                assert not isinstance(found, bool), (one, found)
                assert one.value is not None, (one, found)
                assert found == number(one.value), (one, found)
                assert low <= found <= high


@pytest.mark.parametrize(
    ("body", "given"),
    [
        (MoveBody, {"offset_base_m": [False, False, True]}),
        (MoveBody, {"offset_base_m": [0.0, 0.0, "1"]}),
        (MoveBody, {"offset_base_m": [0.0, 0.0, 1.0], "duration_s": True}),
        (LookBody, {"frames": True}),
        (LookBody, {"frames": 5.5}),
        (LookBody, {"frames": 9007199254740994.0}),
    ],
)
def test_a_body_that_moves_the_arm_takes_numbers_alone(
    body: type[RequestBody], given: dict[str, Any]
) -> None:
    found = answered(lambda: validated(body, given, "body"))
    assert isinstance(found, Refused)
    assert LookBody(frames=5.0).frames == 5  # as in JSON Schema: 5.0 is an integer
