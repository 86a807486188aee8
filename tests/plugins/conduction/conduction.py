"""A voxel physics by a stranger, from public services alone: the effective conductivity of a periodic cell."""

from dataclasses import dataclass, field
from itertools import product
from typing import ClassVar

import numpy as np

import sppm_pipeline as sppm
from sppm_pipeline import numerics as num


class Bricks:
    """A grid of trilinear bricks of conductivity `k` (nz, ny, nx), as the multigrid asks for."""

    components = 1

    def __init__(self, k, edges):
        self.k, self.shape, self.edges, self.weight = k, k.shape, np.array(edges), np.zeros(k.size)
        mass, stiff = np.array([[2, 1], [1, 2]]) / 6, np.array([[1, -1], [-1, 1]])
        parts = [[stiff if a == axis else mass for a in (2, 1, 0)] for axis in range(3)]  # gradient along x, y, z
        scales = np.prod(edges) / self.edges**2
        self.element = sum(s * np.kron(np.kron(z, y), x) for s, (z, y, x) in zip(scales, parts, strict=True))
        self.corners = np.array(list(product((0, 1), repeat=3)))  # z, y, x
        self.diagonal = (self.element[0, 0] * num.node_sums(k)).ravel()

    def at_corners(self, v):
        return np.stack([np.roll(v.reshape(self.shape), -c, (0, 1, 2)) for c in self.corners])

    def flows(self, v):  # out of the nodes, for potentials at the corners of the bricks
        parts = self.k * np.einsum("ab,b...->a...", self.element, v)
        return sum(np.roll(part, c, (0, 1, 2)) for part, c in zip(parts, self.corners, strict=True)).ravel()

    def apply(self, mode, v, r, out, work):
        f = self.flows(self.at_corners(v))
        out[:] = f if mode == num.APPLY else r - f if mode == num.RESIDUAL else v + self.weight * (r - f)
        return float(v @ f if mode == num.APPLY else r @ out)


def conductivity(k, edges=(1.0, 1.0, 1.0)):
    """Effective conductivity (3, 3) of voxels (nz, ny, nx) with edges (hx, hy, hz)."""
    levels, fields = [fine := Bricks(np.asarray(k, float), np.array(edges) / max(edges))], []
    while num.coarser(levels[-1].shape) is not None:
        levels.append(Bricks(num.coarsened(levels[-1].k), 2 * levels[-1].edges))
    grids = num.Hierarchy.of(list(levels), 1, 0.0)
    for axis in range(3):  # a ramp along the axis, and the periodic potential that balances its flows
        ramp = (fine.corners[:, 2 - axis] * fine.edges[axis])[:, None, None, None] * np.ones(fine.shape)
        b, u = -fine.flows(ramp), np.zeros(fine.k.size)
        num.solve(grids, b, u, np.zeros_like(u), grids.workspace(), num.SolverStop(1e-9, 0.0, 300), 0.0, 1.0)
        fields.append(fine.at_corners(u) + ramp)
    energies = np.einsum("iazyx,ab,jbzyx,zyx->ij", fields, fine.element, fields, fine.k, optimize=True)
    return energies / (fine.k.size * np.prod(fine.edges))


@dataclass(frozen=True, eq=False)
class Conductivity(sppm.Report):
    """What the cell conducts, over what its solid does."""

    k: np.ndarray = field(metadata=sppm.number("#3.#3", box="conductivity"))


@dataclass(frozen=True, kw_only=True)
class Conduct(sppm.Homogenizer):
    """Compute the conductivity of a cell with an insulating void."""

    name: ClassVar[str] = "homogenize.conduct"

    def bytes_of_a_voxel(self, threads):
        return 500

    def run(self, context: sppm.Context, source: sppm.ScalarField | sppm.Voxels) -> Conductivity:
        return Conductivity(conductivity(self.cell_of(context, source).of_voxels((0.0, 1.0), float), (1.0, 1.0, 1.0)))
