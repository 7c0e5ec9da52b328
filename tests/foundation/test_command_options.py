"""Options that belong together are one parameter of the function and several of the command."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import typer
from typer.testing import CliRunner

from foundation.command_options import host_and_port, unfolded


class Place(NamedTuple):
    port: Annotated[int, typer.Option(min=1)]
    host: str = "127.0.0.1"


@dataclass(frozen=True)
class Spoiled:
    loss: Annotated[float, typer.Option(max=1.0)] = 0.0


def test_each_field_is_an_option_with_its_limits_and_default() -> None:
    called = []

    def serve(place: Place, spoiled: Spoiled, seed: int = 3) -> None:
        """Serve."""
        called.append((place, spoiled, seed))

    app = typer.Typer()
    app.command()(unfolded(serve))
    assert CliRunner().invoke(app, ["--port", "5", "--loss", "0.5"]).exit_code == 0
    assert called == [(Place(5), Spoiled(0.5), 3)]
    for wrong in (["--port", "0"], ["--port", "5", "--loss", "2"], []):
        assert CliRunner().invoke(app, wrong).exit_code == 2


def test_an_address_of_ipv6_stands_in_brackets() -> None:
    known = {"[fe80::1%eth0]:47000": ("fe80::1%eth0", 47000), "plc_2.cell:502": ("plc_2.cell", 502)}
    assert {text: host_and_port(text, "here") for text in known} == known
