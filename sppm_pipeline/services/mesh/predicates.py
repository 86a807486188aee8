"""On which side of a plane or line a point lies, without rounding errors.

The determinant is computed in doubles first, with a bound of its error; only where the bound does not decide, it is
computed again as a sum of doubles that carries no error at all (Shewchuk 1997, "Adaptive precision floating-point
arithmetic and fast robust geometric predicates"). Products that leave the range of doubles are the one exception.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.jit.compiled import jit

# bounds of the error over the sum of the terms' sizes, from the same paper
_PLANE = (7.0 + 56.0 * 2.0**-53) * 2.0**-53
_LINE = (3.0 + 16.0 * 2.0**-53) * 2.0**-53
_SPLIT = 134217729.0  # 2^27 + 1


@jit
def side_of_plane(a: F64, b: F64, c: F64, p: F64) -> int:
    """Sign of the determinant of (a - p, b - p, c - p): 1 if a, b, c turn clockwise seen from p, 0 in the plane."""
    ax, ay, az = a[0] - p[0], a[1] - p[1], a[2] - p[2]
    bx, by, bz = b[0] - p[0], b[1] - p[1], b[2] - p[2]
    cx, cy, cz = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    x1, x2, y1, y2, z1, z2 = by * cz, bz * cy, bz * cx, bx * cz, bx * cy, by * cx
    value = ax * (x1 - x2) + ay * (y1 - y2) + az * (z1 - z2)
    size = abs(ax) * (abs(x1) + abs(x2)) + abs(ay) * (abs(y1) + abs(y2)) + abs(az) * (abs(z1) + abs(z2))
    if abs(value) > _PLANE * size:
        return 1 if value > 0.0 else -1
    if size == 0.0:
        return 0
    return _exact_side(a, b, c, p)


@jit
def side_of_line(ax: float, ay: float, bx: float, by: float, px: float, py: float) -> int:
    """Sign of the determinant of (a - p, b - p): 1 if p lies to the left of the way from a to b, 0 on the line."""
    one, other = (ax - px) * (by - py), (ay - py) * (bx - px)
    value, size = one - other, abs(one) + abs(other)
    if abs(value) > _LINE * size:
        return 1 if value > 0.0 else -1
    if size == 0.0:
        return 0
    # a third dimension turns the line into a plane: (a, 0), (b, 0), (p, -1) seen from (p, 0)
    a, b, c, p = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    a[0], a[1], a[2] = ax, ay, 0.0
    b[0], b[1], b[2] = bx, by, 0.0
    c[0], c[1], c[2] = px, py, 1.0
    p[0], p[1], p[2] = px, py, 0.0
    return _exact_side(a, b, c, p)


@jit
def _add(total: F64, n: int, value: float) -> int:
    """Add a double to a sum of n doubles that do not overlap, smallest first; the new n."""
    kept = 0
    for i in range(n):
        rounded = value + total[i]
        of_value = rounded - total[i]
        rest = (value - of_value) + (total[i] - (rounded - of_value))
        value = rounded
        if rest != 0.0:
            total[kept] = rest
            kept += 1
    if value != 0.0:
        total[kept] = value
        kept += 1
    return kept


@jit
def _split(value: float) -> tuple[float, float]:
    """Upper and lower half of the digits."""
    # Veltkamp's splitting (Dekker 1971)
    far = _SPLIT * value
    high = far - (far - value)
    return high, value - high


@jit
def _product(x: float, y: float) -> tuple[float, float]:
    """The product as two doubles, the rounded one and what rounding lost."""
    # Dekker's product: the halves of both factors multiply without rounding
    rounded = x * y
    xh, xl = _split(x)
    yh, yl = _split(y)
    return rounded, xl * yl - (((rounded - xh * yh) - xl * yh) - xh * yl)


@jit
def _exact_side(a: F64, b: F64, c: F64, p: F64) -> int:
    # the differences, as two doubles each
    parts = np.empty((3, 3, 2))
    for k in range(3):
        corner = a if k == 0 else (b if k == 1 else c)
        for i in range(3):
            difference = corner[i] - p[i]
            of_p = corner[i] - difference
            parts[k, i, 0] = difference
            parts[k, i, 1] = (corner[i] - (difference + of_p)) + (of_p - p[i])
    # 3 axes x 2 turns x 8 products x 4 doubles: at most 192 are added
    total = np.empty(512)
    n = 0
    for i in range(3):
        for turn in range(2):
            j = (i + 1 + turn) % 3
            k = (i + 2 - turn) % 3
            for which in range(8):
                x, y, z = parts[0, i, which & 1], parts[1, j, which >> 1 & 1], parts[2, k, which >> 2]
                if x == 0.0 or y == 0.0 or z == 0.0:
                    continue
                if turn:
                    x = -x
                high, low = _product(x, y)
                for factor in (low, high):
                    if factor != 0.0:
                        upper, lower = _product(factor, z)
                        n = _add(total, n, lower)
                        n = _add(total, n, upper)
    if n == 0:
        return 0
    return 1 if total[n - 1] > 0.0 else -1
