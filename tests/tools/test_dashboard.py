"""The dashboard that is shipped is that of its table."""

from tests.support.paths import ROOT
from tools.dashboard import PATH, dashboard, expressions_of, text


def test_the_file_is_what_the_table_makes() -> None:
    assert (ROOT / PATH).read_text(encoding="utf-8") == text(), "run: python -m tools.dashboard"


def test_every_panel_has_its_place_and_every_curve_its_name() -> None:
    panels = dashboard()["panels"]
    places = {(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in panels}
    assert len(places) == len(panels)
    for panel in panels:
        assert all(target["legendFormat"] for target in panel["targets"])
        assert len({target["refId"] for target in panel["targets"]}) == len(panel["targets"])
    assert len(expressions_of(dashboard())) > 30
