"""The compiled kernels: small algebra as numpy does it, no allocation, no rounding that depends on order."""

import tracemalloc

import numpy as np
import pytest
from numba.core.errors import NumbaError
from numba.core.runtime import _nrt_python, rtsys

from foundation.compiled import allocation_free
from plant_emulator.core.mechanics.multibody import forward_dynamics, multibody_work
from plant_emulator.core.mechanics.spatial import (
    cross,
    dot,
    less_outer,
    less_square,
    product,
    stretched,
    turned,
    turned_back,
)
from plant_emulator.core.right_hand_side import EncoderShafts, advance
from tests.plant_emulator.known_answers.stand import resting_arm

POSE = [0.0, 50.0, -75.0, 0.0, -25.0, 0.0]
UPPER = np.triu_indices(3)


def test_small_algebra_is_numpys() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        a, b = rng.normal(size=3), rng.normal(size=3)
        m, n = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
        s, k = m + m.T, float(rng.normal())
        flat_m, flat_n, six = tuple(m.ravel()), tuple(n.ravel()), tuple(s[UPPER])
        pairs = [
            (dot(tuple(a), tuple(b)), a @ b),
            (cross(tuple(a), tuple(b)), np.cross(a, b)),
            (turned(flat_m, tuple(a)), m @ a),
            (turned_back(flat_m, tuple(a)), m.T @ a),
            (stretched(six, tuple(a)), s @ a),
            (product(flat_m, flat_n), (m @ n).ravel()),
            (less_square(six, k, tuple(a)), (s - k * np.outer(a, a))[UPPER]),
            (less_outer(flat_m, k, tuple(a), tuple(b)), (m - k * np.outer(a, b)).ravel()),
        ]
        for ours, theirs in pairs:
            np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-13)


def test_a_kernel_that_would_allocate_does_not_compile() -> None:
    def spills(x: float) -> float:
        return float(np.zeros(3)[0] + x)

    with pytest.raises(NumbaError):
        allocation_free(spills)(1.0)


def test_thousands_of_steps_allocate_nothing() -> None:
    stand = resting_arm(POSE, 30.0)
    idle, target = np.zeros((3, 6)), np.full(6, 0.1)
    arrays = (stand.state, idle[0], target, EncoderShafts(idle[1], idle[2]))
    _nrt_python.memsys_enable_stats()
    blocks, peaks = [], []
    for steps in (1, 1, 5000, 5000, 5000):
        tracemalloc.start()
        before = rtsys.get_allocation_stats().alloc
        advance(*arrays, steps, 5e-4, stand.model, stand.work)
        blocks.append(rtsys.get_allocation_stats().alloc - before)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert set(blocks[2:]) == {blocks[1]}  # a call wraps its arguments once, whatever the number of steps
    # What wraps the arguments; a number a step would be 40,000. Other threads may allocate during one call.
    assert min(peaks[2:]) < 4000


def test_a_locked_or_massless_body_is_passed_over() -> None:
    stand = resting_arm(POSE, 0.0)
    mech, work = stand.model.mechanism, multibody_work(10)
    rng = np.random.default_rng(2)
    q, rate, force = rng.normal(size=10), np.zeros(10), rng.normal(size=10) * 100.0
    mech.free[[2, 3, 5, 6]] = 0.0
    found = np.full(10, np.nan)
    forward_dynamics(q, rate, force, mech, work, found)
    assert (found[[2, 3, 5, 6]] == 0.0).all()
    assert np.isfinite(found).all()
    mech.mass[3], mech.centre[3], mech.inertia[3] = 0.0, 5.0, 0.0  # a centre without mass means nothing
    moved = np.zeros(10)
    forward_dynamics(q, rate, force, mech, work, moved)
    mech.centre[3] = -5.0
    again = np.zeros(10)
    forward_dynamics(q, rate, force, mech, work, again)
    np.testing.assert_array_equal(moved, again)
    assert np.abs(moved - found).max() > 1e-3
