"""A small fuzz of every decoder in each test run; ``--hypothesis-profile=search`` draws others."""

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from tests.fuzz.targets import TARGETS


@pytest.mark.parametrize("name", TARGETS)
def test_a_decoder_lets_pass_nothing_but_its_refusal(name: str) -> None:
    target, seeds = TARGETS[name]

    edited = st.lists(st.tuples(st.integers(0, 1499), st.binary(max_size=4)), max_size=4)

    @hypothesis_settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
    @given(st.sampled_from(seeds), edited)
    def bent(sound: bytes, edits: list[tuple[int, bytes]]) -> None:
        data = sound
        for place, piece in edits:
            at = place % (len(data) + 1)
            data = data[:at] + piece + data[at + (place % 3) :]
        target(data)

    bent()
    assert any(target(seed) for seed in seeds), "no sound input was accepted: nothing was tried"
