"""docs/faults.md says what the code does: kinds, parameters, ranges, defaults, causes."""

import re

from fastapi.routing import APIRoute

from foundation.configuration import load
from plant_emulator.config.service import PlantServiceConfig
from plant_emulator.core.faults.kinds import FAULTS
from plant_emulator.core.plant import Plant
from plant_emulator.shell import fault_api
from tests.plant_emulator.camera.camera_world import CONFIGS
from tests.plant_emulator.faults.test_fault_face import NearPlant
from tests.plant_emulator.plant_world import plant_config
from tests.support.pages import page, rows

PAGE = page("faults.md")
_PARAMETER = re.compile(
    r"`(?P<name>\w+)`(?: (?P<low>[−\d.]+) to (?P<high>[\d.]+))?(?: \((?P<default>[^)]*)\))?"
)


def test_every_kind_is_there_with_its_parameters_ranges_and_defaults() -> None:
    table = rows(PAGE, "kind")
    assert list(table) == list(FAULTS)
    for kind, (parameters, _) in table.items():
        model = FAULTS[kind]
        schema = model.model_json_schema()["properties"]
        named = {found["name"]: found for found in _PARAMETER.finditer(parameters)}
        assert list(named) == [name for name in model.model_fields if name != "kind"], kind
        for name, found in named.items():
            default = model.model_fields[name].default
            if found["default"] or not model.model_fields[name].is_required():
                shown = f"{default:g}" if type(default) in (int, float) else str(default).lower()
                assert found["default"] == shown, (kind, name)
            if found["low"]:
                low = schema[name].get("minimum", schema[name].get("exclusiveMinimum"))
                assert (float(found["low"].replace("−", "-")), float(found["high"])) == (
                    low,
                    schema[name]["maximum"],
                ), (kind, name)


def test_every_cause_is_there_with_its_status() -> None:
    table = rows(PAGE, "cause")
    for cause, status in fault_api._STATUS_OF_CAUSE.items():
        assert table[cause][0] == str(int(status))
    assert table["refused.fault_present"][0] == table["refused.too_many_faults"][0] == "409"


def test_the_address_and_the_ways_are_those_of_the_face() -> None:
    service = load(PlantServiceConfig, CONFIGS / "plant_service.yaml")
    assert f"{service.fault_face.host}:{service.fault_face.port}" in PAGE
    assert service.fault_face.allowed is False
    app = fault_api.create_app(NearPlant(Plant(plant_config(), seed=1)), True)
    ways = {route.path for route in app.routes if isinstance(route, APIRoute) and route.include_in_schema}
    assert ways == {"/faults", "/faults/kinds", "/faults/{number}", "/truth", "/world/restart"}
    assert "`GET /truth`" in PAGE
    assert "`POST /world/restart`" in PAGE
