"""`longreach config list`: every key, with what may be set and who sets it."""

import json
from pathlib import Path

from typer.testing import CliRunner

from protocol.errors import ConfigurationError
from testbed.cli.config import app
from testbed.scenarios.configuration_keys import described_keys
from tests.support.paths import CONFIGS


def test_a_key_comes_with_unit_limits_provenance_and_who_sets_it(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["list", "strain_std", "--json", str(tmp_path / "keys.json")])
    assert done.exit_code == 0, done.output
    assert "vision.programs.positioning.strain_std = 0.0065" in done.output
    assert "set by arms/long_crane/vision.yaml" in " ".join(done.output.split())
    keys = json.loads((tmp_path / "keys.json").read_text())["keys"]
    assert len(keys) == 2
    assert all("[M]" in key["comment"] and "≤ 0.2" in key["allowed"] for key in keys)


def test_a_pattern_matches_and_a_draw_of_a_scenario_counts() -> None:
    (mass,) = described_keys(CONFIGS, "plant.payload.mass*")
    assert (mass.unit, mass.value) == ("kg", "0.0")
    assert "scenarios/standard.yaml" in mass.set_by
    assert len(described_keys(CONFIGS)) > 600


def test_what_no_key_holds_is_refused() -> None:
    done = CliRunner().invoke(app, ["list", "nonsense"])
    assert isinstance(done.exception, ConfigurationError)
    assert done.exception.cause == "configuration.unknown_key"
