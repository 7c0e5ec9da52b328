"""The broken controllers that have a class of their own, each under the clause of the case meant for it."""

from conformance.runner import reference_cases
from tests.conformance.mutant_report import BrokenController
from tests.conformance.mutants.datagram import DATAGRAM_MUTANTS
from tests.conformance.mutants.ending import ENDING_MUTANTS
from tests.conformance.mutants.handshake import HANDSHAKE_MUTANTS
from tests.conformance.mutants.key import KEY, KEY_MUTANTS
from tests.conformance.mutants.link import LINK_MUTANTS
from tests.conformance.mutants.link_key import LINK_KEY_MUTANTS
from tests.conformance.mutants.repetition import REPETITION_MUTANTS
from tests.conformance.mutants.request import REQUEST_MUTANTS
from tests.conformance.mutants.session import SESSION_MUTANTS
from tests.conformance.mutants.stop import STOP_MUTANTS
from tests.conformance.mutants.stream import STREAM_MUTANTS

# Those that hold no key.
PLAIN = (
    *DATAGRAM_MUTANTS,
    *SESSION_MUTANTS,
    *REQUEST_MUTANTS,
    *HANDSHAKE_MUTANTS,
    *LINK_MUTANTS,
    *STOP_MUTANTS,
    *STREAM_MUTANTS,
    *ENDING_MUTANTS,
    *REPETITION_MUTANTS,
)
_CLAUSES = {case.number: case.clause for case in reference_cases()}

MUTANTS = (
    *(
        BrokenController(f"{mutant.make.__name__}-{mutant.case}", _CLAUSES[mutant.case], mutant.make)
        for mutant in PLAIN
    ),
    *(
        BrokenController(f"{mutant.make.__name__}-{mutant.case}", _CLAUSES[mutant.case], mutant.make, KEY)
        for mutant in (*KEY_MUTANTS, *LINK_KEY_MUTANTS)
    ),
)
