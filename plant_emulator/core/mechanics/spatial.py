"""Vectors and matrices of three as tuples, which the compiler keeps in registers.

An array of three numbers costs more to address than to multiply. A ``Vector`` is (x, y, z), a ``Matrix`` its
three rows in a row, a ``Symmetric`` matrix (xx, xy, xz, yy, yz, zz). ``vector`` and ``matrix`` read them from
tables.
"""

from numpy import float64
from numpy.typing import NDArray

from foundation.compiled import allocation_free

Array = NDArray[float64]
Vector = tuple[float, float, float]
Symmetric = tuple[float, float, float, float, float, float]
Matrix = tuple[float, float, float, float, float, float, float, float, float]


@allocation_free
def vector(table: Array, row: int, first: int) -> Vector:
    """Three numbers of ``row`` of ``table``, from column ``first`` on."""
    return table[row, first], table[row, first + 1], table[row, first + 2]


@allocation_free
def matrix(table: Array, i: int) -> Matrix:
    """Entry ``i`` of ``table`` (n, 3, 3)."""
    return (
        table[i, 0, 0], table[i, 0, 1], table[i, 0, 2],
        table[i, 1, 0], table[i, 1, 1], table[i, 1, 2],
        table[i, 2, 0], table[i, 2, 1], table[i, 2, 2],
    )  # fmt: skip


@allocation_free
def plus(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@allocation_free
def minus(a: Vector, b: Vector) -> Vector:
    """a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@allocation_free
def scaled(k: float, a: Vector) -> Vector:
    """k a."""
    return k * a[0], k * a[1], k * a[2]


@allocation_free
def dot(a: Vector, b: Vector) -> float:
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@allocation_free
def cross(a: Vector, b: Vector) -> Vector:
    """a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@allocation_free
def turned(m: Matrix, a: Vector) -> Vector:
    """M a."""
    return (
        m[0] * a[0] + m[1] * a[1] + m[2] * a[2],
        m[3] * a[0] + m[4] * a[1] + m[5] * a[2],
        m[6] * a[0] + m[7] * a[1] + m[8] * a[2],
    )


@allocation_free
def turned_back(m: Matrix, a: Vector) -> Vector:
    """Mᵀ a."""
    return (
        m[0] * a[0] + m[3] * a[1] + m[6] * a[2],
        m[1] * a[0] + m[4] * a[1] + m[7] * a[2],
        m[2] * a[0] + m[5] * a[1] + m[8] * a[2],
    )


@allocation_free
def stretched(s: Symmetric, a: Vector) -> Vector:
    """S a."""
    return (
        s[0] * a[0] + s[1] * a[1] + s[2] * a[2],
        s[1] * a[0] + s[3] * a[1] + s[4] * a[2],
        s[2] * a[0] + s[4] * a[1] + s[5] * a[2],
    )


@allocation_free
def product(a: Matrix, b: Matrix) -> Matrix:
    """A B."""
    x = turned_back(b, (a[0], a[1], a[2]))
    y = turned_back(b, (a[3], a[4], a[5]))
    z = turned_back(b, (a[6], a[7], a[8]))
    return x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2]


@allocation_free
def less_square(s: Symmetric, k: float, a: Vector) -> Symmetric:
    """S − k a aᵀ."""
    x, y, z = scaled(k, a)
    return (
        s[0] - x * a[0], s[1] - x * a[1], s[2] - x * a[2],
        s[3] - y * a[1], s[4] - y * a[2], s[5] - z * a[2],
    )  # fmt: skip


@allocation_free
def less_outer(m: Matrix, k: float, a: Vector, b: Vector) -> Matrix:
    """M − k a bᵀ."""
    x, y, z = scaled(k, a)
    return (
        m[0] - x * b[0], m[1] - x * b[1], m[2] - x * b[2],
        m[3] - y * b[0], m[4] - y * b[1], m[5] - y * b[2],
        m[6] - z * b[0], m[7] - z * b[1], m[8] - z * b[2],
    )  # fmt: skip
