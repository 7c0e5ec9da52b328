"""``python -m tools.evidence`` makes every table anew that is made of the rows under docs/results.

``python -m tools.evidence keep RUN NAME COMMIT COMMAND…`` copies a campaign's rows there first: RUN is its
directory, COMMIT what it ran on, COMMAND what was typed.

``python -m tools.evidence supersede NAME REASON…`` takes a campaign away that no longer counts, for what was
changed since: a line of docs/results/superseded.csv is left, and the commit from which git has its rows.
"""

import sys
from pathlib import Path

from tools.evidence.campaigns import supersede
from tools.evidence.kept_rows import committed, keep
from tools.evidence.pages import PAGES, sections
from tools.protocol_page import filled

if __name__ == "__main__":
    match sys.argv[1:]:
        case ["keep", run, name, commit, *command] if command:
            keep(Path(run), name, commit, " ".join(command))
        case ["supersede", name, *reason] if reason:
            supersede(name, " ".join(reason), committed(name))
        case [_, *_]:
            sys.exit(__doc__)
    made = sections()
    for page in PAGES:
        page.write_text(filled(page.read_text(encoding="utf-8"), made), encoding="utf-8")
