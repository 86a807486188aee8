"""The share of struts in walls: stiffness, Poisson's ratio and isotropy at one density.

    python -m benchmarks.struts [--draws 4] [--resolution 56] [--density 0.28]

40 hyperuniform pores, joined by `connect.mbdst` with 3 to 5 tunnels each of a radius of 0.06 cell sizes.
"""

from __future__ import annotations

import argparse

import numpy as np

import sppm_pipeline as sppm

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)


def draw(share: float, seed: int, density: float, resolution: int) -> list[float]:
    """E over the bound of Hashin and Shtrikman, E over that of the solid, Poisson's ratio, universal anisotropy."""
    pipeline = sppm.Pipeline(
        [
            {"stage": "tune.porosity", "recipe": "cell", "target": 1 - density},
            {"stage": "homogenize.voxel", "id": "elastic", "resolution": resolution},
        ],
        recipes={
            "cell": [
                {"stage": "sample.hyperuniform", "total": 40},
                {"stage": "connect.mbdst", "degree": [3, 5], "mode": "greedy"},
                {"stage": "field.walls", "struts": share, "tunnel_radius": 0.06},
            ]
        },
        seed=seed,
    )
    found = pipeline.run()["elastic"].summary()
    young, bound = found["isotropic"]["E"], found["bounds"]["hashin_shtrikman_young"][1]
    return [young / bound, young, found["isotropic"]["nu"], found["universal_anisotropy"]]


def main() -> None:
    """Print a row of a table for each share."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--resolution", type=int, default=56)
    parser.add_argument("--density", type=float, default=0.28)
    args = parser.parse_args()
    print("| struts | E over the bound | E / E_s | Poisson's ratio | A^U |\n|---|---|---|---|---|", flush=True)
    for share in SHARES:
        found = np.array([draw(share, 1 + i, args.density, args.resolution) for i in range(args.draws)])
        mean, error = found.mean(0), found.std(0, ddof=1) / np.sqrt(args.draws)
        values = " | ".join(f"{m:.3f} ± {e:.3f}" for m, e in zip(mean, error, strict=True))
        print(f"| {share:g} | {values} |", flush=True)


if __name__ == "__main__":
    main()
