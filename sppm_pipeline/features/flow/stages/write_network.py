"""``write.network``: pores and throats for programs of pore networks.

The pore network of a periodic cell: tunnels cut at its faces, measured in its field, and their permeability.

A throat is taken as a tube of slowly changing circular section, by Hagen and Poiseuille: its resistance is that of
thin slices in a row, ``8 viscosity / pi * integral ds / r^4``, with r the distance from its axis to the nearest wall.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, Headline, Length, Microstructure, ScalarField, Stage, Voxels, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.flow.permeability import DARCY
from sppm_pipeline.formats import extension_of
from sppm_pipeline.numerics import cell_centers

SLICES_OF_A_VOXEL = 2
"""Slices of a throat for each voxel along it: a heuristic, not sensitive, as distances to a wall change little within
half a voxel."""

ROUNDING = 1e-9
"""Share of a throat within which two planes are crossed at once, in an edge of the cell, but for rounding."""

MIN_LENGTH = 0.01
"""Throats between pores that overlap keep this fraction of their length, as programs divide by it: a heuristic, which
sets the resistance of no throat, as that follows from the radii along the whole axis."""


class CutNetwork(NamedTuple):
    """Tunnels of a periodic cell as throats that lie within it; those that leave the cell are cut at its faces.

    `coords` (n, 3) are the pores in cell sizes, then images of these on opposite faces, and ends of throats that were
    cut; `image_of` (n,) is the index of the first of all pores that are one in the periodic cell. Throats have their
    ends in `conns` (t, 2), the lower index first, `vectors` (t, 3) from the first end to the second, and the `tunnel`
    (t,) of which each is the whole or a part.
    """

    coords: NDArray[np.float64]
    image_of: NDArray[np.int64]
    conns: NDArray[np.int64]
    tunnel: NDArray[np.int64]
    vectors: NDArray[np.float64]

    def chosen(self, throats: NDArray[np.bool_]) -> CutNetwork:
        """All pores, and some of the throats."""
        conns, tunnel, vectors = self.conns[throats], self.tunnel[throats], self.vectors[throats]
        return self._replace(conns=conns, tunnel=tunnel, vectors=vectors)


def cut_at_faces(centers: NDArray[np.float64], edges: NDArray[np.integer], shift: NDArray[np.integer]) -> CutNetwork:
    """Throats within the unit cell, of tunnels from ``centers[i]`` to ``centers[j] + shift``: `centers` (n, 3) in the
    unit cube, `edges` (m, 2) and `shift` (m, 3) of integers.
    """
    coords = [np.asarray(center) for center in centers]
    image_of = list(range(len(centers)))
    images: dict[tuple[int, ...], int] = {}
    conns: list[tuple[int, int]] = []
    tunnel: list[int] = []
    vectors: list[NDArray[np.float64]] = []
    count = len(centers)

    def node(own: int, place: NDArray[np.float64], offset: NDArray[np.float64]) -> int:
        """The node at `place` of the pore or cut `own`, moved by whole cells."""
        if own < len(centers) and not offset.any():
            return own
        key = (own, *offset.astype(int).tolist())
        if key not in images:
            images[key] = len(coords)
            coords.append(np.clip(place, 0.0, 1.0))
            image_of.append(own)
        return images[key]

    for number, ((i, j), moved) in enumerate(zip(edges.tolist(), shift.astype(np.float64), strict=True)):
        start, end = centers[i], centers[j] + moved
        step = end - start
        # parameters along the tunnel at which it crosses a face of any image of the cell
        cuts = {
            (plane - start[axis]) / step[axis]
            for axis in range(3)
            for plane in range(
                int(np.floor(min(start[axis], end[axis]))), int(np.ceil(max(start[axis], end[axis]))) + 1
            )
            if min(start[axis], end[axis]) < plane < max(start[axis], end[axis])
        }
        inner: list[float] = []
        # planes that are crossed at once, at an edge or corner of the cell, cut once
        for t in sorted(cuts):
            if t - (inner[-1] if inner else 0.0) > ROUNDING and t < 1 - ROUNDING:
                inner.append(t)
        stops = [0.0, *inner, 1.0]
        owners = [i, *range(count, count + len(inner)), j]
        offsets = [np.zeros(3), *[np.zeros(3)] * len(inner), moved]
        count += len(inner)
        for k in range(len(stops) - 1):
            first, last = start + stops[k] * step, start + stops[k + 1] * step
            # the middle of a part decides in which cell it lies: its ends may lie on faces
            cell = np.floor(0.5 * (first + last))
            a = node(owners[k], first - cell, offsets[k] - cell)
            b = node(owners[k + 1], last - cell, offsets[k + 1] - cell)
            conns.append((min(a, b), max(a, b)))
            tunnel.append(number)
            vectors.append(last - first if a <= b else first - last)
    _, first_of, group = np.unique(np.array(image_of, np.int64), return_index=True, return_inverse=True)
    return CutNetwork(
        np.array(coords, np.float64).reshape(-1, 3), first_of[group], np.array(conns, np.int64).reshape(-1, 2),
        np.array(tunnel, np.int64), np.array(vectors, np.float64).reshape(-1, 3),
    )  # fmt: skip


def _in_cell(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The images of points in the unit cube, its high faces excluded."""
    inside = points - np.floor(points)
    inside[inside >= 1] = 0  # what lies below 0 by less than rounding
    return inside


class Measured(NamedTuple):
    """Sizes of pores (n,) and throats (t,), in cell sizes."""

    pore_radius: NDArray[np.float64]  # distance from the center to the nearest wall; half a cell edge without any
    pore_volume: NDArray[np.float64]  # void that is nearer to this pore than to any other; together all void
    throat_radius: NDArray[np.float64]  # least distance from the axis to a wall; 0 where the axis meets the solid
    size_factor: NDArray[np.float64]  # pi / 8 / integral ds / r^4: conductance times viscosity, cubed cell sizes


def measured(network: CutNetwork, values: NDArray[np.float32], threads: int = 1) -> Measured:
    """Measure pores and throats in `values` (n, n, n), indexed z, y, x: a periodic field at the centers of n voxels
    along an edge of the cell, below 0 in the solid.
    """
    from scipy.ndimage import map_coordinates
    from scipy.spatial import KDTree

    from sppm_pipeline.numerics import closed_across as wrapped
    from sppm_pipeline.numerics import marching_cubes

    n = values.shape[0]
    vertices = marching_cubes(wrapped(values), 0.0, (0.5 / n,) * 3, (1 / n,) * 3)[0]
    # distances to the vertices of the surface stand for those to its triangles, which are smaller than a voxel
    tree = KDTree(_in_cell(vertices), boxsize=1.0) if len(vertices) else None

    def to_wall(points: NDArray[np.float64]) -> NDArray[np.float64]:
        inside = _in_cell(points)
        place = (inside.T * n - 0.5)[::-1]
        value = map_coordinates(values, place, order=1, mode="grid-wrap")
        distance = np.full(len(points), 0.5) if tree is None else tree.query(inside, workers=threads)[0]
        return np.where(value > 0, distance, 0.0)

    length = np.linalg.norm(network.vectors, axis=1)
    slices = np.maximum(1, np.ceil(SLICES_OF_A_VOXEL * n * length)).astype(np.int64)
    first = np.cumsum(slices) - slices
    # the slices of all throats together, for one query of the tree
    throat = np.repeat(np.arange(len(slices)), slices)
    along = (np.arange(slices.sum()) - first[throat] + 0.5) / slices[throat]
    starts = network.coords[network.conns[:, 0]]
    radius = to_wall(starts[throat] + along[:, None] * network.vectors[throat])
    with np.errstate(divide="ignore"):
        resistance = np.bincount(throat, radius**-4.0, len(slices)) * length / slices
    least = np.minimum.reduceat(radius, first) if len(first) else np.empty(0)

    nearest, volume = KDTree(network.coords), np.zeros(len(network.coords))
    for layer in range(n):
        y, x = np.nonzero(values[layer] >= 0)
        places = (np.stack([x, y, np.full_like(x, layer)], 1) + 0.5) / n
        volume += np.bincount(nearest.query(places, workers=threads)[1], minlength=len(volume)) / n**3
    return Measured(to_wall(network.coords), volume, least, np.pi / 8 / resistance)


def permeability(network: CutNetwork, size_factor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Permeability of a periodic network of throats, (3, 3), cell sizes squared.

    Of all pressures in the pores those are taken at which no fluid is gained or lost in any of them, and the power
    that is dissipated under unit gradients gives the tensor, symmetric and never negative. `size_factor` (t,) is the
    flux times viscosity over the difference in pressure; 0 for closed throats.
    """
    from scipy.sparse import coo_array, csr_array
    from scipy.sparse.csgraph import connected_components
    from scipy.sparse.linalg import spsolve

    owner = np.unique(network.image_of, return_inverse=True)[1][network.conns]
    throats, pores = len(owner), int(owner.max(initial=-1)) + 1
    if not throats:
        return np.zeros((3, 3))
    row = np.arange(throats).repeat(2)
    rise = csr_array(coo_array((np.tile([-1.0, 1.0], throats), (row, owner.reshape(-1))), shape=(throats, pores)))
    weighted = csr_array(rise * size_factor[:, None])
    laplacian = csr_array(rise.T @ weighted)
    _, piece = connected_components(abs(laplacian), directed=False)
    free = np.ones(pores, bool)
    free[np.unique(piece, return_index=True)[1]] = False  # one pressure of each piece is given
    pressure = np.zeros((pores, 3))
    if free.any():
        load = -(weighted.T @ network.vectors)[free]
        pressure[free] = spsolve(laplacian[free][:, free].tocsc(), load).reshape(-1, 3)
    # differences of pressure along throats under unit gradients; with conductances, the dissipated power is quadratic
    drop = network.vectors + rise @ pressure
    return np.asarray(drop.T @ (size_factor[:, None] * drop))


@dataclass(frozen=True, kw_only=True)
class WriteNetwork(Stage):
    """Write the pores and throats of a cell or an image in the words of OpenPNM and PoreSpy, all in meters.

    A cell of pores and tunnels has them; the void of an image, such as a scan, or of any other field is parted at
    its throats by a watershed of the distance to the walls, as by SNOW (Gostick 2017).

    A CSV file is opened by `openpnm.io.network_from_csv`; an NPZ file holds the arrays of the dictionary that
    `openpnm.io.network_from_porespy` takes. Throats that leave the cell are cut at its faces, where pores are
    put that carry the labels `xmin` to `zmax`; `pore.image_of` says which pores are one as the cell repeats.

    The inscribed diameter of a throat is the least along its straight axis, of the largest balls that fit. Its
    `hydraulic_size_factors` are those of a tube of circular section as wide as these balls, all along it. Void belongs
    to the nearest pore, so that throats have no volume. From the size factors comes the reported permeability, which is
    that of this network; for that of the void itself see `homogenize.permeability`.

    An image is open at its sides, also if it repeats: where a pore meets one, another pore is put. Balls on the way
    from a pore through the throat to the next one set the size factor; as channels are wider than their balls, the
    permeability comes out too low: at 0.4 to 0.5 of that of the void on two blobs of half solid.
    """

    name: ClassVar[str] = "write.network"
    reported: ClassVar[tuple[str, ...]] = (
        "pores", "throats", "closed", "network_k.#3.#3", "network_k_m2.#3.#3", "network_darcy_mean",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (Headline("network_darcy_mean", "k of the network model", "darcy"),)

    path: str = options.write_path("network.csv", suffixes=(".csv", ".npz"))
    resolution: int = options.resolution(96, note="of the grid on which radii are measured", minimum=8, maximum=512)
    cell: Length | None = options.cell(None, note="if the cell has none yet, or another one is wanted")

    def run(self, context: Context, source: ScalarField | Voxels) -> None:
        """Measure pores and throats, write the file and report the permeability."""
        edge_mm = source.edge_mm if isinstance(source, ScalarField) else _longest(source) if source.physical else None
        edge_mm = edge_mm if self.cell is None else self.cell.mm()
        if edge_mm is None:
            raise ConfigError(
                "a pore network is written in meters, but the cell has no physical size", hint="say `cell: 5 mm`"
            )
        if not isinstance(source, Microstructure):
            self._write_image(context, source, edge_mm)
            return
        if source.interiors > 1 or max(source.colors) > 1:
            raise DesignError(
                "a pore network is that of one periodic cell, not of a tile set", hint="take one interior and one color"
            )
        # radii are measured on the grid: too coarse a one may close throats
        if (coarse := source.coarseness(1 / self.resolution)) is not None:
            context.warn(coarse)
        graph = source.graph
        network = cut_at_faces(graph.pores.centers, graph.edges, graph.shift)
        if not len(network.conns):
            raise DesignError("there are no tunnels: a pore network needs throats", hint="connect the pores first")
        values = np.ascontiguousarray(source.sample(cell_centers(self.resolution), context.threads).T)
        sizes = measured(network, values, context.threads)
        is_open = sizes.throat_radius > 0
        if not is_open.all():
            context.warn(f"{np.count_nonzero(~is_open)} throats are closed and left out: solid lies on their axes")
            network = network.chosen(is_open)
            sizes = sizes._replace(throat_radius=sizes.throat_radius[is_open], size_factor=sizes.size_factor[is_open])
        k = permeability(network, sizes.size_factor)
        self._write(context, network, sizes, k, 1e-3 * edge_mm, int(np.count_nonzero(~is_open)))

    def _write_image(self, context: Context, source: ScalarField | Voxels, edge_mm: float) -> None:
        """The network of the void of an image, or of a field on its grid."""
        from sppm_pipeline.features.flow.numerics.regions import regions_of

        if isinstance(source, Voxels):
            void, spacing = ~source.solid(), np.array(source.spacing) / _longest(source)
        else:
            if (coarse := source.coarseness(1 / self.resolution)) is not None:
                context.warn(coarse)
            void = source.sample(cell_centers(self.resolution, source.cells), context.threads) >= 0
            spacing = np.full(3, 1 / self.resolution)
        if void.all() or not void.any():
            raise DesignError(f"the image is all {'void' if void.all() else 'solid'}, so there is no pore network")
        extent = tuple(float(n * h) for n, h in zip(void.shape, spacing, strict=True))
        found = regions_of(void, tuple(map(float, spacing)))
        network = CutNetwork(
            found.coords, np.arange(len(found.coords)), found.conns, np.arange(len(found.conns)),
            found.coords[found.conns[:, 1]] - found.coords[found.conns[:, 0]],
        )  # fmt: skip
        sizes = Measured(found.radius, found.volume, found.throat, found.size_factor)
        k, opening = np.zeros((3, 3)), found.volume == 0
        for axis in range(3):  # a flow comes in at all openings of a side together, and goes out at those opposite
            at_side = np.abs(found.coords[:, axis] / extent[axis] - 0.5) > 0.5 - 1e-9
            joined = np.where(at_side & opening, np.argmax(at_side & opening), network.image_of)
            k[axis, axis] = permeability(network._replace(image_of=joined), found.size_factor)[axis, axis]
        k = np.where(k > 1e-12 * k.max(), k, 0) / np.prod(extent)  # without a way through, rounding is left
        self._write(context, network, sizes, k, 1e-3 * edge_mm, 0, extent)

    def _write(
        self, context: Context, network: CutNetwork, sizes: Measured, k: NDArray[np.float64], meters: float,
        closed: int, extent: tuple[float, ...] = (1.0, 1.0, 1.0),
    ) -> None:  # fmt: skip
        columns = _columns(network, sizes, meters, extent)
        target = context.output(self.path)
        if extension_of(self.path) == ".npz":
            arrays: dict[str, Any] = dict(columns)
            with target.open("wb") as file:
                np.savez_compressed(file, **arrays)
        else:
            target.write_text(_table(columns), encoding="utf-8")
        context.report(
            pores=len(network.coords), throats=len(network.conns), closed=closed, length_unit="m",
            model="Hagen-Poiseuille flow in the throats of a network", network_k=k.tolist(),
            network_k_m2=(k * meters**2).tolist(), network_darcy_mean=float(np.trace(k)) / 3 * meters**2 / DARCY,
        )  # fmt: skip


def _longest(image: Voxels) -> float:
    return max(n * h for n, h in zip(image.shape, image.spacing, strict=True))


def _columns(
    network: CutNetwork, sizes: Measured, meters: float, extent: tuple[float, ...]
) -> dict[str, NDArray[np.generic]]:
    """The arrays of the file, by the names that OpenPNM gives them."""
    length = np.linalg.norm(network.vectors, axis=1)
    # OpenPNM takes the length of a throat without its pores
    outside = np.maximum(length - sizes.pore_radius[network.conns].sum(1), MIN_LENGTH * length)
    sides = {
        f"pore.{axis}{side}": np.abs(network.coords[:, number] - place) < 1e-9
        for number, axis in enumerate("xyz")
        for side, place in (("min", 0.0), ("max", extent[number]))
    }
    return {
        "pore.coords": network.coords * meters, "pore.inscribed_diameter": 2 * sizes.pore_radius * meters,
        "pore.volume": sizes.pore_volume * meters**3, "pore.image_of": network.image_of, **sides,
        "throat.conns": network.conns, "throat.tunnel": network.tunnel,
        "throat.inscribed_diameter": 2 * sizes.throat_radius * meters, "throat.length": outside * meters,
        "throat.total_length": length * meters, "throat.hydraulic_size_factors": sizes.size_factor * meters**3,
    }  # fmt: skip


def _table(columns: dict[str, NDArray[np.generic]]) -> str:
    """One row for each pore and throat of the same number; fields beyond the last are empty."""
    flat: dict[str, list[object]] = {}
    for name, array in columns.items():
        if array.ndim == 1:
            flat[name] = array.tolist()
        else:
            flat |= {f"{name}[{k}]": array[:, k].tolist() for k in range(array.shape[1])}
    rows = max(map(len, flat.values()))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(flat)
    writer.writerows([values[row] if row < len(values) else "" for values in flat.values()] for row in range(rows))
    return text.getvalue()
