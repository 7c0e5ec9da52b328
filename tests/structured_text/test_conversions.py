"""Every conversion between whole numbers and bit strings, against numpy's."""

import numpy as np

from structured_text.program import CompiledProgram
from structured_text.types import ELEMENTARY

WHOLE = {name: np.dtype(of.code) for name, of in ELEMENTARY.items() if of.code in "bhiqBHIQ"}


def edges(of: np.dtype) -> list[int]:
    """The ends of the type, what lies around 0, and the ends of the narrower ones as far as they fit."""
    near = {
        s * (1 << bits) + by
        for bits in (0, 7, 8, 15, 16, 31, 32, 63, 64)
        for by in (-1, 0, 1)
        for s in (-1, 1)
    }
    return sorted(value for value in near if np.iinfo(of).min <= value <= np.iinfo(of).max)


def test_every_conversion_between_whole_numbers_keeps_the_bits() -> None:
    pairs = [(a, b) for a in WHOLE for b in WHOLE]
    made = "FUNCTION F_{0}_{1} : {1} VAR_INPUT v : {0}; END_VAR F_{0}_{1} := {2}{1}(v); END_FUNCTION\n"
    texts = (made.format(a, b, f"{a}_TO_" if k % 2 else "TO_") for k, (a, b) in enumerate(pairs))
    program = CompiledProgram({"pairs.st": "".join(texts)})
    for a, b in pairs:
        found = {value: program.call(f"F_{a}_{b}", v=value).result for value in edges(WHOLE[a])}
        assert [*found.values()] == np.array([*found], WHOLE[a]).astype(WHOLE[b]).tolist(), f"{a}_TO_{b}"
