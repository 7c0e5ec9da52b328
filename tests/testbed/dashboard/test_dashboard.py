"""The dashboard that is shipped is that of its table."""

from controller.shell.controller_figures import FIGURES as OF_CONTROLLER
from plant_emulator.shell.plant_figures import FIGURES as OF_PLANT
from testbed.dashboard.panels import PATH, dashboard, expressions_of, metrics_of, text
from tests.support.paths import ROOT
from vision_pc.shell.rest.metrics import FIGURES as OF_VISION


def test_the_file_is_what_the_table_makes() -> None:
    assert (ROOT / PATH).read_text(encoding="utf-8") == text(), "run: python -m testbed.dashboard.panels"


def test_every_panel_has_its_place_and_every_curve_its_name() -> None:
    panels = dashboard()["panels"]
    places = {(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in panels}
    assert len(places) == len(panels)
    for panel in panels:
        assert all(target["legendFormat"] for target in panel["targets"])
        assert len({target["refId"] for target in panel["targets"]}) == len(panel["targets"])
    assert len(expressions_of(dashboard())) > 30


def test_it_asks_for_nothing_that_no_service_tells() -> None:
    tables = {"controller": OF_CONTROLLER, "plant_emulator": OF_PLANT, "vision_pc": OF_VISION}
    told = {f"longreach_{service}_{figure.name}" for service, table in tables.items() for figure in table}
    asked = metrics_of(dashboard())
    histograms = {name for name in asked if name.endswith("_bucket")}  # compared with running services
    assert len(asked) > 20
    assert asked - histograms <= told, asked - histograms - told
