"""Arithmetic in one fixed order: clamping; products, inverses and eigenvalues of small matrices.

NumPy hands `@`, `dot` and `linalg` to BLAS and LAPACK, which choose their code by the processor and
so add in another order, or round once where another rounds twice. Control feeds back what it
computes: a last bit grows. Here each sum has one order, in NumPy's element by element operations or
in Python's floats, and a recording made on one processor is replayed by another.
"""

import math

import numpy as np

from follower_vision.geometry.camera_model import Vector

_MOST_SWEEPS = 20
"""Jacobi's method needs four or five for a 3x3 matrix."""


def clip(value: float, largest: float) -> float:
    """Return a value limited to -`largest` to `largest`, in its own unit."""
    return min(max(value, -largest), largest)


def product(a: Vector, b: Vector) -> Vector:
    """Return the matrix product of (N, K) and (K, M)."""
    total = a[:, :1] * b[0]
    for k in range(1, len(b)):
        total += a[:, k : k + 1] * b[k]
    return np.asarray(total)


def transformed(matrix: Vector, vector: Vector) -> Vector:
    """Return the product of a 3x3 matrix and a vector, (3,)."""
    x, y, z = vector.tolist()
    return np.array([a * x + b * y + c * z for a, b, c in matrix.tolist()])


def quadratic_form(matrix: Vector, vector: Vector) -> float:
    """Return v' M v of a 3x3 matrix and a vector, (3,)."""
    x, y, z = vector.tolist()
    along = [a * x + b * y + c * z for a, b, c in matrix.tolist()]
    return float(x * along[0] + y * along[1] + z * along[2])


def length(vector: Vector) -> float:
    """Return the Euclidean length of a vector, (N,)."""
    return math.sqrt(sum(x * x for x in vector.tolist()))


def inverse_of_covariance(matrix: Vector) -> Vector:
    """Return the inverse of a symmetric positive definite 3x3 matrix, by its LDL' factors.

    Raises:
        ZeroDivisionError: it is singular.
    """
    (a, _, _), (b, d, _), (c, e, f) = matrix.tolist()
    low1, low2 = b / a, c / a
    second = d - low1 * b
    rest = e - low2 * b
    low3 = rest / second
    third = f - low2 * c - low3 * rest
    # The inverse of the unit lower triangle, (1; m1 1; m2 m3 1).
    m1, m3 = -low1, -low3
    m2 = low1 * low3 - low2
    w1, w2, w3 = 1.0 / a, 1.0 / second, 1.0 / third
    xy, xz, yz = m1 * w2 + m2 * m3 * w3, m2 * w3, m3 * w3
    return np.array(
        [
            [w1 + m1 * m1 * w2 + m2 * m2 * w3, xy, xz],
            [xy, w2 + m3 * m3 * w3, yz],
            [xz, yz, w3],
        ]
    )


def largest_eigenvalue(matrix: Vector) -> float:
    """Return the largest eigenvalue of a symmetric 2x2 or 3x3 matrix."""
    if len(matrix) == 2:
        (a, _), (b, c) = matrix.tolist()
        return float((a + c) / 2 + math.hypot((a - c) / 2, b))
    (xx, _, _), (xy, yy, _), (xz, yz, zz) = matrix.tolist()
    for _ in range(_MOST_SWEEPS):
        scale = abs(xx) + abs(yy) + abs(zz)
        if scale + abs(xy) + abs(xz) + abs(yz) == scale:
            break
        xx, yy, xy, xz, yz = _rotated(xx, yy, xy, xz, yz)
        xx, zz, xz, xy, yz = _rotated(xx, zz, xz, xy, yz)
        yy, zz, yz, xy, xz = _rotated(yy, zz, yz, xy, xz)
    return float(max(xx, yy, zz))


def _rotated(
    pp: float, qq: float, pq: float, pr: float, qr: float
) -> tuple[float, float, float, float, float]:
    """Turn two axes so that nothing couples them (Jacobi's rotation; Golub and Van Loan, 8.5)."""
    if pq == 0:
        return pp, qq, 0.0, pr, qr
    apart = (qq - pp) / (2 * pq)
    tangent = math.copysign(1.0, apart) / (abs(apart) + math.sqrt(1.0 + apart * apart))
    cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
    sine = tangent * cosine
    moved = tangent * pq
    return pp - moved, qq + moved, 0.0, cosine * pr - sine * qr, sine * pr + cosine * qr
