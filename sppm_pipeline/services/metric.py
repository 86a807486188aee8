"""Metrics: symmetric matrices M in which distances ``sqrt(v^T M v)`` of stretched structures are measured.

A structure that is stretched s times along a unit vector d is the plain one in ``M = R diag(s^-2, 1, 1) R^T``, the
rotation R turning x to d. A metric is held as its six entries xx, yy, zz, xy, xz, yz.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import F64

Metric = F64
"""(n, 6) float64: one matrix a row."""

PLAIN = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
"""The metric of plain distances."""

_ROWS, _COLUMNS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)


def stretched_metric(stretch: F64, direction: F64) -> Metric:
    """Metrics (n, 6) of structures that are stretched s > 0 times along directions (n, 3); below 1 they are flattened.

    Directions are of any length; of the length 0 where there is none: the metric is plain there.
    """
    length = np.linalg.norm(direction, axis=1)
    unit = np.divide(direction, length[:, None], out=np.zeros_like(direction), where=length[:, None] > 0)
    return np.asarray(PLAIN + (stretch**-2.0 - 1.0)[:, None] * unit[:, _ROWS] * unit[:, _COLUMNS])


def check_metric(metric: Metric, n: int) -> None:
    """Raise a ValueError unless there are n metrics, all positive definite."""
    if metric.shape != (n, 6):
        raise ValueError(f"the metrics have the shape {metric.shape}, expected ({n}, 6)")
    xx, yy, _, xy, _, _ = metric.T
    # Sylvester's criterion: all leading minors are positive
    if not ((xx > 0) & (xx * yy > xy * xy) & (determinants(metric) > 0)).all():
        raise ValueError("a metric is not positive definite")


def matrices(metric: Metric) -> F64:
    """The same as matrices, (n, 3, 3)."""
    made = np.empty((len(metric), 3, 3))
    made[:, _ROWS, _COLUMNS] = metric
    made[:, _COLUMNS, _ROWS] = metric
    return made


def determinants(metric: Metric) -> F64:
    """Determinants (...,) of metrics (..., 6): the squared volume, in the metric, of a unit volume."""
    xx, yy, zz, xy, xz, yz = (metric[..., i] for i in range(6))
    return np.asarray(xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz))


def upper_roots(metric: Metric) -> F64:
    """Upper triangular matrices U with ``U^T U = M``, (n, 3, 3): lengths in M are those of U x."""
    return np.asarray(np.linalg.cholesky(matrices(metric)).transpose(0, 2, 1), np.float64)


def half_widths(metric: Metric) -> F64:
    """Extents of the unit balls of metrics along x, y, z, (n, 3): ``sqrt(diag(M^-1))``."""
    return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(matrices(metric)), axis1=1, axis2=2)))


def semi_axes(metric: Metric) -> F64:
    """Longest and shortest semi-axis of the unit balls of metrics, (n, 2)."""
    values = np.linalg.eigvalsh(matrices(metric))
    return np.asarray(values[:, [0, -1]] ** -0.5)


def lengths_in(metric: Metric, steps: F64) -> F64:
    """Lengths (n,) of vectors (n, 3), each in a metric of its own."""
    x, y, z = steps.T
    xx, yy, zz, xy, xz, yz = metric.T
    squared = xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))
