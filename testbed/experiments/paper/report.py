"""The comparison with the paper as one HTML file with everything in it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from testbed.campaigns.campaign import CampaignRequest
from testbed.campaigns.row_file import Row
from testbed.experiments.paper import published
from testbed.experiments.paper.comparison import TABLES, Compared, Conclusion
from testbed.reporting.plots import svg
from testbed.reporting.report import rendered
from testbed.reporting.run_record import KeptRun, beginning

EYES = {
    "opencv": "rendered pictures, markers by OpenCV from the left lens as in the paper",
    "pixels": "rendered pictures, markers by Longreach's own stereo edges",
    "model": "no pictures: an eye model whose noise and failures were measured from pictures",
}


def write_comparison(
    request: CampaignRequest,
    settings: Any,
    tables: tuple[Mapping[str, Sequence[Compared]], Mapping[str, Sequence[Conclusion]]],
    drawn: Mapping[str, Figure],
    rows: Mapping[str, Sequence[Row]],
) -> Path:
    """The HTML file in ``request.out``: tables side by side, conclusions, figures, and every run."""
    beside, concluded = tables
    html = rendered(
        "comparison.html.j2",
        request=request,
        settings=settings,
        eyes=EYES[settings.eyes],
        tables=[(TABLES[name].title, beside[name], concluded[name]) for name in beside],
        figures=[(name, published.FIGURES[name], svg(figure, name)) for name, figure in drawn.items()],
        kinds=[(kind, _columns(done), done) for kind, done in rows.items()],
        run=KeptRun(request.out, beginning()),
    )
    path: Path = request.out / f"{'-'.join([*beside, *drawn])}.html"
    path.write_text(html, encoding="utf-8")
    return path


def _columns(rows: Sequence[Row]) -> list[str]:
    """What is told of every run: its seed, its errors after each input, and what stopped it."""
    wanted = ["seed", "configuration", "payload_kg", "mount_deg", "rotation_error_deg"]
    wanted += [f"{stage}_{axis}_mm" for stage in ("input1", "input2") for axis in "xyz"]
    wanted += ["run_s", "failure"]
    return [column for column in wanted if any(row.get(column) is not None for row in rows)]
