"""Forty and some wrong texts: the suite or the twin catches each."""

import pytest

from conformance.runner import run_reference
from controller_st import program
from structured_text.errors import StructuredTextError
from structured_text.program import CompiledProgram
from tests.conformance.simulated_network import SimulatedNetwork
from tests.controller_st.mutants import MUTANTS, TextMutant
from tests.controller_st.suite import SimulatedTextController, settings
from tests.controller_st.twin import Twin, recorded_scans, worst_of

SPOOL = 1e-9


def mutated(mutant: TextMutant) -> dict[str, str]:
    """The texts with the mutant in."""
    shipped = settings()
    found = program.texts(shipped.arm, shipped.controller)
    text = found[mutant.file]
    assert mutant.right in text, f"{mutant.file} has no {mutant.right}"
    return found | {mutant.file: text.replace(mutant.right, mutant.wrong, 1)}


@pytest.fixture(scope="module")
def twin() -> Twin:
    """A second and a half of a motion and a stop."""
    return Twin(recorded_scans(600))


def test_there_are_forty() -> None:
    assert len({(m.file, m.right, m.wrong) for m in MUTANTS}) == len(MUTANTS) >= 40


@pytest.mark.slow("every wrong text is compiled, and asked until it is caught")
@pytest.mark.parametrize("mutant", [m for m in MUTANTS if m.cases], ids=lambda m: f"{m.file}: {m.right}")
def test_the_suite_catches_the_wrong_text(
    network: SimulatedNetwork, monkeypatch: pytest.MonkeyPatch, mutant: TextMutant
) -> None:
    texts = mutated(mutant)
    monkeypatch.setattr(program, "texts", lambda *_: texts)
    assert mutant.cases is not None
    caught = []
    with SimulatedTextController(network) as controller:
        for case in mutant.cases:
            summary = run_reference("127.0.0.1", controller.port, numbers=[case], motion=True)
            if summary.ended is not None or summary.results[0].outcome.value in ("fail", "unsupported"):
                caught.append(case)
                break
    assert caught, f"none of {mutant.cases} catches it"


@pytest.mark.slow("every wrong text is compiled")
@pytest.mark.parametrize("mutant", [m for m in MUTANTS if not m.cases], ids=lambda m: f"{m.file}: {m.right}")
def test_the_twin_catches_the_wrong_text(twin: Twin, mutant: TextMutant) -> None:
    try:
        compiled = CompiledProgram(mutated(mutant))
    except StructuredTextError as error:
        pytest.fail(f"not compiled: {error}")
    assert worst_of(compiled, twin) > SPOOL


@pytest.mark.slow("the program is compiled")
def test_the_sound_text_passes_both(twin: Twin) -> None:
    shipped = settings()
    assert worst_of(CompiledProgram(program.texts(shipped.arm, shipped.controller)), twin) < SPOOL
