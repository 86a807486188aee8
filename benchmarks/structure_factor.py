"""Structure factor S(k) of pores scattered over 4 x 4 x 4 blocks at long waves, by sampler and wave length.

    python -m benchmarks.structure_factor

Waves of k periods over the edge of a block, k in quarters, averaged over shells and seeds; independent pores have 1.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.families.sampler import Sampler
from sppm_pipeline.method.sampling.stealthy import stealthy_waves, throw_stealthy
from sppm_pipeline.method.sampling.structure_factor import longest_waves, structure_factor
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_hyperuniform import Hyperuniform
from sppm_pipeline.nouns.palette import Blocks, Palette
from sppm_pipeline.testing.plain_context import PlainContext

EDGE, PORES, SEEDS = 4, 68, 3
SHELLS = np.array([0, 0.3, 0.6, 0.9, 1.1, 1.6, 2.1, 2.6, 3.1, 3.6, 4.1])


def scattered(sampler: Sampler, seed: int) -> NDArray[np.float64]:
    """Pores of a periodic box of blocks, thrown block by block; in the unit cube."""
    blocks = Blocks(np.ones((EDGE,) * 3, np.bool_), True)
    pores = sampler.run(PlainContext(seed, palette=Palette(EDGE**3, (0, 0, 0), blocks=blocks)), None)
    return np.asarray((pores.centers + blocks.sites[pores.piece]) / EDGE)


def at_once(stealth: float, seed: int) -> NDArray[np.float64]:
    """Stealthy pores of the whole box."""
    count = PORES * EDGE**3
    return throw_stealthy(np.random.default_rng(seed), count, stealthy_waves(count, stealth), 0.7 * count ** (-1 / 3))


WAYS: dict[str, Callable[[int], NDArray[np.float64]]] = {
    "independent": lambda seed: np.random.default_rng(seed).random((PORES * EDGE**3, 3)),
    "darts, 68 a block": lambda seed: scattered(DartThrowing(total=PORES), seed),
    "hyperuniform, stealth 0.2": lambda seed: scattered(Hyperuniform(total=PORES, stealth=0.2), seed),
    "hyperuniform, stealth 0.4": lambda seed: scattered(Hyperuniform(total=PORES), seed),
    "hyperuniform, stealth 0.5": lambda seed: scattered(Hyperuniform(total=PORES, stealth=0.5), seed),
    "all at once, stealth 0.2": lambda seed: at_once(0.2, seed),
}


def main() -> None:
    """Print the table."""
    waves = longest_waves(int(4 / 3 * np.pi * (SHELLS[-1] * EDGE) ** 3 / 2))
    length = np.linalg.norm(waves.vectors(), axis=1) / EDGE
    print("| pores | " + " | ".join(f"{low:g}-{high:g}" for low, high in pairwise(SHELLS)) + " |")
    print("|---|" + "---|" * (len(SHELLS) - 1))
    for name, way in WAYS.items():
        factor = np.mean([structure_factor(way(seed), waves) for seed in range(SEEDS)], axis=0)
        shells = [factor[(low < length) & (length <= high)].mean() for low, high in pairwise(SHELLS)]
        print(f"| {name} | " + " | ".join(f"{value:.2g}" for value in shells) + " |", flush=True)


if __name__ == "__main__":
    main()
