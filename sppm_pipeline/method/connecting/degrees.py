"""Which degree bounds a connected spanning subgraph can satisfy, and a graph that does."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import I64


def feasible_degrees(n: int, lower: int, upper: int, *, images: int = 1, two_edge_connected: bool = False) -> None:
    """Raise DesignError unless a connected graph on n pores with all degrees in [lower, upper] exists.

    Two pores may share `images` tunnels: 1, or `images_per_pair` on periodic axes. If every tunnel must lie on a loop,
    the lower bound is at least 2.
    """
    if n < 1:
        raise DesignError(f"{n} pores can't be connected", hint="at least 1 pore is needed")
    if lower < 0 or upper < lower:
        raise DesignError(
            f"degree bounds [{lower}, {upper}] are not a range", hint="give 0 <= lower <= upper, for example [3, 5]"
        )
    most = images * (n - 1)
    if lower > most:
        raise DesignError(
            f"{n} pores can't have {lower} tunnels each: a pore has at most {most}",
            hint=f"lower the bound to {most}, or place at least {-(-lower // images) + 1} pores",
        )
    if n == 1:
        return
    loops = " and every tunnel on a loop" if two_edge_connected else ""
    needed = 2 if n > 2 or two_edge_connected else 1
    if upper < needed:
        raise DesignError(
            f"{n} pores can't be connected with at most {upper} tunnels each{loops}",
            hint=f"the upper bound must be at least {needed}",
        )
    if two_edge_connected and most < 2:
        raise DesignError(
            f"{n} pores joined by one tunnel have no loop", hint="place at least 3 pores, or allow single tunnels"
        )
    if lower == upper and n * lower % 2:
        raise DesignError(
            f"{n} pores can't have exactly {lower} tunnels each: {n} x {lower} tunnel ends don't make pairs",
            hint=f"set the upper bound to {upper + 1}, or use an even number of pores",
        )


def clamped_degrees(n: int, lower: int, upper: int, *, images: int = 1) -> tuple[int, int, bool]:
    """Degree bounds relaxed to what n pores allow, for faces that hold only a few pores, and whether they differ.

    The lower bound becomes min(lower, images * (n - 1)); the upper bound is raised by one where equal bounds would need
    an odd number of tunnel ends.
    """
    low = min(lower, images * max(n - 1, 0))
    high = upper + 1 if low == upper and n * low % 2 else upper
    return low, high, (low, high) != (lower, upper)


def harary_edges(n: int, degree: int) -> I64:
    """Pairs (m, 2) of a graph in which every degree is `degree`, but one is a step higher if n * degree is odd.

    The pairs join positions on a ring: Harary's graph, `degree`-edge-connected for degree >= 2 (F. Harary, The maximum
    connectivity of a graph, PNAS 48, 1962). A pair occurs q + 1 or q times if degree = q (n - 1) + r. Degree 1 on an
    odd ring gives one path of three.
    """
    i = np.arange(n, dtype=np.int64)
    full, rest = divmod(degree, n - 1)
    rings = [np.stack(np.triu_indices(n, 1), axis=1).astype(np.int64)] * full
    rings += [np.stack([i, (i + step) % n], axis=1) for step in range(1, rest // 2 + 1)]
    if rest % 2:
        half = n // 2
        across = i[:half] if n % 2 == 0 else i[: half + 1]
        rings.append(np.stack([across, (across + half) % n], axis=1))
    pairs = np.concatenate(rings) if rings else np.zeros((0, 2), np.int64)
    return np.sort(pairs, axis=1)
