"""Programs as books have them: a PID controller, a ramp, a state machine with an edge and a timer."""

import pytest

from structured_text.program import CompiledProgram

PID = """
FUNCTION_BLOCK FB_Pid (* after the textbook: positional form, clamped, with anti-windup *)
VAR_INPUT
    f_set, f_actual, f_kp, f_tn, f_tv, f_cycle, f_low, f_high : LREAL;
END_VAR
VAR_OUTPUT
    f_out : LREAL;
    x_limited : BOOL;
END_VAR
VAR
    f_integral, f_before, f_error, f_raw : LREAL;
    x_first : BOOL := TRUE;
END_VAR
f_error := f_set - f_actual;
IF x_first THEN
    f_before := f_error;
    x_first := FALSE;
END_IF
f_raw := f_kp * (f_error + f_integral / f_tn + f_tv * (f_error - f_before) / f_cycle);
f_out := LIMIT(f_low, f_raw, f_high);
x_limited := f_out <> f_raw;
IF NOT x_limited THEN
    f_integral := f_integral + f_error * f_cycle;
END_IF
f_before := f_error;
END_FUNCTION_BLOCK
FUNCTION_BLOCK FB_Ramp
VAR_INPUT
    f_target, f_rate, f_cycle : LREAL;
END_VAR
VAR_OUTPUT
    f_value : LREAL;
    x_done : BOOL;
END_VAR
VAR
    f_step : LREAL;
END_VAR
f_step := f_rate * f_cycle;
f_value := f_value + LIMIT(-f_step, f_target - f_value, f_step);
x_done := f_value = f_target;
END_FUNCTION_BLOCK
TYPE
    E_Valve : (Closed, Opening, Open, Failed);
END_TYPE
FUNCTION_BLOCK FB_Valve
VAR_INPUT
    x_open, x_at_end : BOOL;
    n_patience : UINT := 3;
END_VAR
VAR_OUTPUT
    state : E_Valve;
END_VAR
VAR
    n_waited : UINT;
    x_before : BOOL;
    x_edge : BOOL;
END_VAR
x_edge := x_open AND NOT x_before;
x_before := x_open;
CASE state OF
    E_Valve.Closed:
        IF x_edge THEN
            state := E_Valve.Opening;
            n_waited := 0;
        END_IF
    E_Valve.Opening:
        n_waited := n_waited + 1;
        IF x_at_end THEN
            state := E_Valve.Open;
        ELSIF n_waited >= n_patience THEN
            state := E_Valve.Failed;
        END_IF
    E_Valve.Open, E_Valve.Failed:
        IF NOT x_open THEN
            state := E_Valve.Closed;
        END_IF
END_CASE
END_FUNCTION_BLOCK
"""


@pytest.fixture(scope="module")
def book() -> CompiledProgram:
    return CompiledProgram({"book.st": PID})


def test_the_pid_controller_gives_the_books_steps_and_does_not_wind_up(book: CompiledProgram) -> None:
    pid = book.new("FB_Pid")
    for name, value in (
        ("set", 1.0),
        ("kp", 2.0),
        ("tn", 0.5),
        ("tv", 0.1),
        ("cycle", 0.1),
        ("low", -10.0),
        ("high", 10.0),
    ):
        setattr(pid, f"f_{name}", value)
    found = []
    for actual in (0.0, 0.0, 0.5, 0.5):
        pid.f_actual = actual
        book.call("FB_Pid", pid)
        found.append(pid.f_out)
    # kp (e + integral / tn + tv de / dt): 2 · 1; 2 (1 + 0.2); 2 (0.5 + 0.4 − 0.5); 2 (0.5 + 0.5)
    assert found == pytest.approx([2.0, 2.4, 0.8, 2.0], abs=1e-12)
    pid.f_high = 1.0
    book.call("FB_Pid", pid)
    before = pid.as_dict()["f_integral"]
    book.call("FB_Pid", pid)
    assert pid.x_limited is True
    assert (pid.f_out, pid.as_dict()["f_integral"]) == (1.0, before)


def test_the_ramp_arrives_exactly_and_stays(book: CompiledProgram) -> None:
    ramp = book.new("FB_Ramp")
    ramp.f_target, ramp.f_rate, ramp.f_cycle = -1.0, 3.0, 0.1
    found = []
    for _ in range(5):
        book.call("FB_Ramp", ramp)
        found.append((ramp.f_value, ramp.x_done))
    assert found == [
        (pytest.approx(-0.3), False),
        (pytest.approx(-0.6), False),
        (pytest.approx(-0.9), False),
        (-1.0, True),
        (-1.0, True),
    ]


def test_the_valve_opens_on_an_edge_and_fails_when_it_does_not_arrive(book: CompiledProgram) -> None:
    valve = book.new("FB_Valve")
    steps = [
        (0, 0, 0),
        (1, 0, 1),
        (1, 0, 1),
        (1, 1, 2),
        (1, 1, 2),
        (0, 1, 0),
        (1, 0, 1),
        (1, 0, 1),
        (1, 0, 1),
        (1, 0, 3),
        (0, 0, 0),
    ]
    found = []
    for asked, at_end, _ in steps:
        valve.x_open, valve.x_at_end = bool(asked), bool(at_end)
        book.call("FB_Valve", valve)
        found.append(valve.state)
    assert found == [state for _, _, state in steps]
