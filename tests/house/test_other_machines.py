"""The machines that the numerical tests stand for are those that this processor can execute."""

import pytest

from tests.support.other_machines import DISTURBANCES, MACHINES, lacking, main, of_today

ZEN_3 = {"sse4_2", "avx", "avx2", "fma", "bmi2"}


@pytest.mark.parametrize(
    ("own", "possible"), [(ZEN_3, {*MACHINES} - {"skylake"}), ({"sse4_2"}, {"nehalem"}), (set(), set())]
)
def test_a_machine_whose_instructions_are_absent_is_no_machine_of_any_day(own, possible):
    drawn = {name for day in range(20) for name in of_today(day, own)}
    assert drawn == {*possible, *DISTURBANCES}


def test_a_machine_whose_instructions_are_absent_is_named_and_not_tried(monkeypatch, capsys):
    monkeypatch.setattr("tests.support.other_machines.own_instructions", lambda: ZEN_3)
    monkeypatch.setattr("tests.support.other_machines.run", lambda *_: pytest.fail("tried"))
    assert main("skylake") == 0
    assert "no avx512bw, avx512cd, avx512dq, avx512f, avx512vl" in " ".join(capsys.readouterr().out.split())
    assert not lacking("haswell", ZEN_3)
