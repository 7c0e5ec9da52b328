"""`longreach validate plant`: the plant against known answers, case by case."""

from pathlib import Path

from rich.table import Table
from rich.text import Text

from testbed.reporting.console import bars, out, table, write_json
from testbed.scenarios.settings import load_settings
from testbed.validation.case import ValidationCase
from testbed.validation.error_sources import Finding, findings, sources
from testbed.validation.plant import FAMILIES, validation_steps
from vision_pc.config.camera import PinholePair

_RELATIONS = {"near": "", "at_most": "≤ ", "at_least": "≥ "}


def validate_plant(config_dir: Path, json_file: Path | None) -> bool:
    """Whether every case of every family passed; prints all of them and writes them to ``json_file``.

    Families whose oracle is not installed are left out, and said to be: then not every family passed.
    """
    cases: list[ValidationCase] = []
    left_out: list[int] = []
    with bars() as shown, shown.step("validating the plant") as bar:
        for family in validation_steps(config_dir):
            cases += family.cases or []
            left_out += [family.number] if family.cases is None else []
            bar.update(family.number / len(FAMILIES), family.title)
    out.print(_table(cases))
    passed = sum(case.passed for case in cases)
    out.print(f"{passed} of {len(cases)} cases in {len(FAMILIES) - len(left_out)} families passed")
    if left_out:
        numbers = ", ".join(map(str, left_out))
        out.print(
            f"families {numbers} left out, so the status is 1: MuJoCo or Pinocchio, which they are compared"
            " with, is not installed (make setup-dev)",
            style="yellow",
        )
    figures = [case._asdict() | {"passed": case.passed} for case in cases]
    write_json(json_file, {"cases": figures, "families_left_out": left_out})
    return passed == len(cases) and not left_out


def _table(cases: list[ValidationCase]) -> Table:
    table = Table(title="plant against known answers", title_justify="left")
    for heading in ("", "case", "unit", "expected", "obtained", "tolerance", "verdict", "source"):
        table.add_column(
            heading, justify="right" if heading in ("expected", "obtained", "tolerance") else "left"
        )
    for case in cases:
        verdict = Text("passed", "green") if case.passed else Text("FAILED", "bold red")
        expected = f"{_RELATIONS[case.relation]}{case.expected:.6g}"
        table.add_row(
            str(case.family), case.name, case.unit, expected, f"{case.obtained:.6g}", f"{case.tolerance:.2g}",
            verdict, case.source,
        )  # fmt: skip
    return table


def validate_error_sources(config_dir: Path, json_file: Path | None) -> bool:
    """Whether every source of error has a provenance and an effect of its own; prints what each alone does.

    Raises ConfigurationError when a number has no provenance.
    """
    told = load_settings(config_dir, {}).vision.camera.calibration
    assert isinstance(told, PinholePair)  # as shipped
    nominal = told.left.model_dump(exclude={"distortion"})
    count = len(sources(nominal))
    found: list[Finding] = []
    with bars() as shown, shown.step("switching on one by one") as bar:
        for finding in findings(config_dir, nominal):
            found.append(finding)
            bar.update(len(found) / count, finding.name)
    rows = [(f.name, f.key, f.provenance, f.effect, f"{f.value:.3g}", f.unit) for f in found]
    headings = ("source of error", "key", "from", "alone", "value", "unit")
    out.print(table("sources of error, each switched on alone", headings, rows))
    passed = all(f.value != 0.0 for f in found)
    write_json(json_file, {"error_sources": [f._asdict() for f in found], "passed": passed})
    return passed
