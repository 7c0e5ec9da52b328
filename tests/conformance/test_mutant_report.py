"""The broken controllers of all sources: each is caught by some case, or it is said why none can."""

from pathlib import Path

import pytest

from conformance.runner import reference_cases
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.kept_verdicts import KeptVerdicts, code_digest
from tests.conformance.mutant_report import (
    BrokenController,
    Verdict,
    asked,
    broken_controllers,
    report,
    verdict,
)
from tests.conformance.mutants.datagram import NoMagic


@pytest.mark.experiment
def test_every_broken_controller_is_caught_or_it_is_said_why_not() -> None:
    verdicts = [verdict(each, asked(each.key, each.clause, each.case)) for each in broken_controllers()]
    lines, wrong = report(verdicts)
    print("\n".join(lines))
    assert wrong == []


def test_every_clause_that_is_asked_for_has_a_broken_controller() -> None:
    broken = {each.clause for each in broken_controllers() if not each.unseen}
    assert {case.clause for case in reference_cases()} <= broken


def test_no_two_broken_controllers_have_one_name() -> None:
    names = [(each.clause, each.name) for each in broken_controllers()]
    assert len(set(names)) == len(names)


def test_a_case_that_the_controller_passes_does_not_catch_it() -> None:
    broken = BrokenController("no magic", "3.5", NoMagic)
    cases = [case for case in reference_cases() if case.number in (101, 102, 103)]
    assert verdict(broken, cases, every=True).caught_by == (102,)
    assert verdict(broken, cases[::2]).caught_by == ()


def test_a_controller_that_falls_over_is_caught() -> None:
    class FallsOver(ControllerUnderTest):
        def turn(self) -> None:
            raise ZeroDivisionError

    broken = BrokenController("falls over", "3.1", FallsOver)
    assert verdict(broken, asked(None, "3.1")).caught_by == (101,)


def test_the_report_counts_by_clause_and_names_what_is_not_as_it_should_be() -> None:
    def of(name: str, unseen: str, *caught_by: int) -> Verdict:
        return Verdict(BrokenController(name, "5.3", ControllerUnderTest, unseen=unseen), caught_by)

    lines, wrong = report([of("a", "", 313), of("b", "has no effect"), of("c", ""), of("d", "nobody", 314)])
    assert lines[1].split() == ["5.3", "4", "2", "1", "313,", "314"]
    assert [each.broken.name for each in wrong] == ["c", "d"]
    assert any("b: has no effect" in line for line in lines)
    assert any("c: NO CASE CATCHES IT" in line for line in lines)


def test_kept_verdicts_count_for_the_same_code_and_are_hints_for_other(tmp_path: Path) -> None:
    rows = tmp_path / "rows.jsonl"
    kept = KeptVerdicts(rows)
    assert kept.of("3.5", "no magic") is None
    kept.keep("3.5", "no magic", (102,))
    kept.keep("3.5", "nothing seen", ())
    again = KeptVerdicts(rows)
    assert again.of("3.5", "no magic") == (102,)
    assert again.of("3.5", "nothing seen") == ()
    assert again.of("3.4", "no magic") is None
    rows.write_text(rows.read_text().replace(code_digest(), "other"))
    other = KeptVerdicts(rows)
    assert other.of("3.5", "no magic") is None
    assert (other.hint("3.5", "no magic"), other.hint("3.5", "nothing seen")) == (102, 0)
