"""Ways of writing a number, right and wrong, and the entrances by which a field may be given one."""

import asyncio
import itertools
import math
import re
from collections.abc import Callable, Iterator
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import httpx
from fastapi import FastAPI
from pydantic import Field

from foundation.configuration import StrictModel, load, parse_overrides, validated
from foundation.rest.server import install_problems
from plant_emulator.core.faults.schedule import FaultOrder
from protocol.errors import ConfigurationError
from testbed.scenarios.scenario import named_request
from vision_pc.application.bodies import RequestBody

MOST = 1_000.0


class Kinds(StrictModel):
    """One field of each kind that takes a number, or what looks like one."""

    real: float = 0.5
    whole: int = 3
    share: Annotated[float, Field(ge=-MOST, le=MOST)] = 0.5
    count: Annotated[int, Field(ge=-MOST, lt=MOST)] = 3
    perhaps: float | None = None
    one_of: float | tuple[float, float] = 0.5
    row: tuple[float, float] = (0.5, 0.5)
    rows: dict[str, tuple[int, ...]] = Field(default_factory=dict)
    flag: bool = False
    text: str = ""
    device: int | str = 0


class KindsBody(RequestBody, Kinds):
    """The same as a request's body."""


class Refused(NamedTuple):
    """How an entrance refuses."""

    cause: str
    words: str


class Writing(NamedTuple):
    """A way to write a number: ``value`` as a person reads it (None: no number); ``plain``: must be taken."""

    text: str
    value: Decimal | None
    plain: bool = False


def decimals() -> Iterator[Writing]:
    digits = (
        "0",
        "1",
        "5",
        "8",
        "12",
        "720",
        "12000",
        "9007199254740993",
        "1" + "0" * 25,
        "7" * 400,
        "7" * 5000,
    )
    parts = itertools.product(
        ("", "-", "+"), ("", "0"), digits, ("", ".", ".0", ".5"), ("", "e3", "E-3", "e999")
    )
    for sign, zeros, whole, fraction, exponent in parts:
        text = sign + zeros + whole + fraction + exponent
        value = Decimal(text)
        yield Writing(text, value, not zeros and abs(value) < 2**53)
    for fraction, exponent in itertools.product((".5", ".007", ".0"), ("", "e3", "e-3")):
        yield Writing(fraction + exponent, Decimal(fraction + exponent))


NUMBERS_WITH_MORE = "{},0 {},5 {}_m {}m {}% {}f {}j 1/{} {}:30 1:{} 1:{}.5 --{} [{}] {{a:_{}}}"
TEXTS_AND_TAGS = "\"{}\" '{}' !!str_{} !!int_0{} !!int_0x{} !!float_1:{}"
NO_NUMBERS = """010 -010 0b11 0o17 0x1F 1_000 1__0 1_0.5 _1 1_ 1'000 true false True FALSE yes no on off y ~
    null None "" .nan .NaN nan NaN .inf -.inf .Inf inf -Infinity Infinity 1e e3 ٥ ５ ² ½ 2026-11-30 12:30:45
    1.2.3 5.5.5 0x - . 1e3.5 −5"""


def others() -> Iterator[Writing]:
    for number in (8, 10, 90, 720, 12000):
        for form in ("{:#x}", "{:#o}", "{:#b}", "{:_}", "!!int {}", "!!float {}"):
            yield Writing(form.format(number), Decimal(number))
        for form in f"{NUMBERS_WITH_MORE} {TEXTS_AND_TAGS}".split():
            yield Writing(form.replace("_", " ").format(number), None)
    for text in ["1 000", *NO_NUMBERS.split()]:
        yield Writing(text, None)


WRITINGS = [*decimals(), *others()]


def from_file(key: str, written: str, directory: Path) -> Any:
    """The field of a YAML file, or how it is refused."""
    (directory / "kinds.yaml").write_text(f"{key}: {written}\n", encoding="utf-8")
    return answered(lambda: getattr(load(Kinds, directory / "kinds.yaml"), key))


def from_command_line(key: str, written: str, _: Path) -> Any:
    """The field as ``--set`` sets it."""
    return answered(
        lambda: getattr(validated(Kinds, parse_overrides([f"kinds.{key}={written}"])["kinds"], "--set"), key)
    )


def from_program_word(key: str, written: str, _: Path) -> Any:
    """The field of a program's request on the command line."""
    return answered(
        lambda: getattr(validated(KindsBody, named_request(f"look,{key}={written}").body, "look"), key)
    )


def from_body(key: str, written: str, _: Path) -> Any:
    """The field of a request's body, the number written into the JSON as it stands."""
    found = post("/kinds", f'{{"{key}": {written}}}')
    return found if isinstance(found, Refused) else found[key]


def answered(ask: Callable[[], Any]) -> Any:
    """What ``ask`` gives, or how it is refused."""
    try:
        return ask()
    except ConfigurationError as error:
        return Refused(error.cause, str(error))


def application() -> FastAPI:
    """An API of ours with a body that has all kinds of fields, and one that is an order of a fault."""
    app = FastAPI()
    install_problems(app, {})

    @app.post("/kinds")
    async def kinds(body: KindsBody) -> dict[str, Any]:
        return body.model_dump()

    @app.post("/faults")
    async def faults(body: FaultOrder) -> dict[str, Any]:
        return body.model_dump()

    return app


CLIENT = httpx.AsyncClient(
    transport=httpx.ASGITransport(application(), raise_app_exceptions=False), base_url="http://localhost"
)


def post(path: str, content: str) -> Any:
    """What the API answers to a body as it stands, or how it refuses."""
    asked = CLIENT.post(path, content=content.encode(), headers={"content-type": "application/json"})
    found = asyncio.run(asked)  # type: ignore[arg-type]
    said = found.json()
    assert found.status_code in (200, 400, 422), f"{found.status_code}: {content[:60]}"
    return said if found.status_code == 200 else Refused(said["cause"], said["detail"])


ENTRANCES = (from_file, from_command_line, from_program_word, from_body)
SHAPES = {"row": "[{0}, {0}]", "rows": '{{"a": [{0}]}}'}
NUMERIC = ("real", "whole", "share", "count", "perhaps", "one_of", "row", "rows")


UNREAD = ("configuration.not_yaml", "configuration.bad_word", "request.bad_request")
NO_JSON = re.compile(r"^\+|\.$|\.[eE]")


def wrong(kind: str, one: Writing, found: Any) -> str:
    """What is wrong with what an entrance made of a writing, nothing where it is right."""
    numbers = [found]
    if kind == "row":
        numbers = list(found) if not isinstance(found, Refused) else numbers
    if kind == "rows":
        numbers = list(found["a"]) if not isinstance(found, Refused) else numbers
    shown = f"{kind} = {one.text[:30]!r} → {str(found)[:160]!r}"
    if isinstance(found, Refused):
        unread = found.cause in UNREAD or "JSON" in found.words
        if one.plain and in_range(kind, one.value) and not (unread and NO_JSON.search(one.text)):
            return f"refused: {shown}"
        named = kind in found.words and found.cause.count(".") == 1
        short = len(found.words) < 400 and "\n" not in found.words
        return "" if unread or (named and short) else f"not by its name: {shown}"
    if all(number is None for number in numbers) and kind == "perhaps" and one.text in ("~", "null"):
        return ""
    for number in numbers:
        if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
            return f"no number: {shown}"
        if one.value is None or not in_range(kind, one.value):
            return f"taken: {shown}"
        if number != (one.value if isinstance(number, int) else float(one.value)):
            return f"another value: {shown}"
    return ""


def in_range(kind: str, value: Decimal | None) -> bool:
    """Whether a field of this kind has the number in it."""
    assert value is not None
    if kind in ("whole", "count", "rows") and value != value.to_integral_value():
        return False
    return kind not in ("share", "count") or -MOST <= value < MOST or (value == MOST and kind == "share")
