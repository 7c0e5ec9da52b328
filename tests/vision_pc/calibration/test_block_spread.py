"""Spreads by blocks of rows are honest, also where single blocks hold most of what is known."""

import numpy as np
import pytest

from vision_pc.core.calibration.joint_play import block_spreads

BLOCKS, ROWS = 10, 12


def columns_of(rng: np.random.Generator) -> np.ndarray:
    """A mean, a slope that some blocks tell more of, and the first block's own offset."""
    weight = np.repeat([1.0] * 6 + [2.0] * 4, ROWS)
    slope = weight * rng.standard_normal(BLOCKS * ROWS)
    own = np.zeros((BLOCKS * ROWS, 1))
    own[:ROWS] = 1.0
    return np.column_stack([np.ones(BLOCKS * ROWS), slope, own])


@pytest.mark.parametrize("shared", [0.0, 0.5])
def test_spreads_are_honest(shared: float) -> None:
    """``shared``: of the errors' size, what a block's rows have alike."""
    rng = np.random.default_rng(1)
    columns = columns_of(rng)
    sums = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    errors, told = [], []
    for _ in range(600):
        alike = np.repeat(rng.standard_normal(BLOCKS), ROWS)
        target = rng.standard_normal(BLOCKS * ROWS) + shared * alike
        found, *_ = np.linalg.lstsq(columns, target, rcond=None)
        errors.append(sums @ found)
        told.append(block_spreads(columns, target, sums, [ROWS] * BLOCKS))
    assert np.mean(np.square(errors) / np.square(told), axis=0) == pytest.approx(1.0, abs=0.2)


def test_what_one_block_alone_tells_is_no_spread() -> None:
    columns = columns_of(np.random.default_rng(2))
    target = np.zeros(BLOCKS * ROWS)
    target[:ROWS] = 5.0  # the first block's own offset
    found = block_spreads(columns, target, np.eye(3)[:2], [ROWS] * BLOCKS)
    assert found == pytest.approx(0.0, abs=1e-9)
