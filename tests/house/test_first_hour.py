"""The first hour's steps are cases: who renumbers a case renumbers its step."""

from conformance.first_hour import COUPLER_STEPS, REFERENCE_STEPS
from conformance.runner import coupler_cases, reference_cases


def test_steps_are_cases_each_once_and_those_that_move_come_behind_those_that_do_not() -> None:
    for steps, cases in ((REFERENCE_STEPS, reference_cases()), (COUPLER_STEPS, coupler_cases())):
        by_number = {case.number: case for case in cases}
        numbers = [step.number for step in steps]
        assert len(set(numbers)) == len(numbers)
        assert set(numbers) <= set(by_number)
        optional = [bool(by_number[number].needs) for number in numbers]
        assert optional == sorted(optional)
        assert all(step.hint.endswith(".") for step in steps)
