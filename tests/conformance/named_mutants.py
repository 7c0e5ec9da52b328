"""The broken controllers that have a class of their own, each under the clause of the case meant for it."""

from conformance.runner import reference_cases
from tests.conformance.ending_mutants import ENDING_MUTANTS
from tests.conformance.handshake_mutants import HANDSHAKE_MUTANTS
from tests.conformance.key_mutants import KEY, KEY_MUTANTS
from tests.conformance.link_key_mutants import LINK_KEY_MUTANTS
from tests.conformance.link_mutants import LINK_MUTANTS
from tests.conformance.mutant_report import BrokenController
from tests.conformance.mutants import MUTANTS as PLAIN_MUTANTS
from tests.conformance.repetition_mutants import REPETITION_MUTANTS
from tests.conformance.stop_mutants import STOP_MUTANTS
from tests.conformance.stream_mutants import STREAM_MUTANTS

_CLAUSES = {case.number: case.clause for case in reference_cases()}

MUTANTS = (
    *(
        BrokenController(f"{mutant.make.__name__}-{mutant.case}", _CLAUSES[mutant.case], mutant.make)
        for mutant in (
            *PLAIN_MUTANTS,
            *HANDSHAKE_MUTANTS,
            *LINK_MUTANTS,
            *STOP_MUTANTS,
            *STREAM_MUTANTS,
            *ENDING_MUTANTS,
            *REPETITION_MUTANTS,
        )
    ),
    *(
        BrokenController(f"{mutant.make.__name__}-{mutant.case}", _CLAUSES[mutant.case], mutant.make, KEY)
        for mutant in (*KEY_MUTANTS, *LINK_KEY_MUTANTS)
    ),
)
