"""The list of the conformance suites' cases; ``python -m tools.protocol_files`` writes it.

The other files of docs/protocol are written by hand: the layouts of version 1 do not change, and tests read
every datagram and register by each file alone.
"""

import csv
import io

from conformance.runner import coupler_cases, reference_cases
from tools.protocol_page import ROOT

FOLDER = ROOT / "docs" / "protocol"


def cases_csv() -> str:
    """Every case of both suites: number, clause that it cites, whether it moves or writes, question."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("suite", "case", "clause", "moves", "question"))
    for suite, cases in (("reference", reference_cases()), ("coupler", coupler_cases())):
        writer.writerows((suite, c.number, c.clause, "yes" if c.motion else "", c.title) for c in cases)
    return out.getvalue()


if __name__ == "__main__":
    (FOLDER / "cases.csv").write_text(cases_csv(), encoding="utf-8")
