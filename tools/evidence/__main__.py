"""``python -m tools.evidence`` makes all tables and pictures anew that are made of rows under docs/results.

``python -m tools.evidence keep RUN NAME COMMIT COMMAND…`` copies a campaign's rows there first: RUN is its
directory, COMMIT what it ran on, COMMAND what was typed.

``python -m tools.evidence supersede NAME REASON…`` takes a campaign away that no longer counts, for what was
changed since: a line of docs/results/superseded.csv is left, and the commit from which git has its rows.
"""

import sys
from pathlib import Path

from tools.evidence.campaigns import supersede
from tools.evidence.kept_rows import committed, every_kept, keep
from tools.evidence.pages import PAGES, sections
from tools.evidence.pictures import IMAGES, pictures
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
    for stem, figure in pictures(every_kept()).items():
        figure.savefig(IMAGES / f"{stem}.png", dpi=110)
