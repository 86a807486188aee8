"""``write.network``: pores and throats for programs of pore networks."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import (
    ConfigError,
    Context,
    DesignError,
    Headline,
    Length,
    Microstructure,
    Palette,
    Size,
    Stage,
    options,
)
from sppm_pipeline.features.flow.permeability import DARCY
from sppm_pipeline.formats import extension_of
from sppm_pipeline.numerics import cell_centers

if TYPE_CHECKING:
    from sppm_pipeline.features.flow.numerics.pore_network import CutNetwork, Measured


@dataclass(frozen=True, kw_only=True)
class WriteNetwork(Stage):
    """Write the pores and throats of a periodic cell in the words of OpenPNM and PoreSpy, all in meters.

    A CSV file is opened by `openpnm.io.network_from_csv`; an NPZ file holds the arrays of the dictionary that
    `openpnm.io.network_from_porespy` takes. Throats that leave the cell are cut at its faces, where pores are
    put that carry the labels `xmin` to `zmax`; `pore.image_of` says which pores are one as the cell repeats.

    The inscribed diameter of a throat is the least along its straight axis, of the largest balls that fit. Its
    `hydraulic_size_factors` are those of a tube of circular section as wide as these balls, all along it. Void belongs
    to the nearest pore, so that throats have no volume. From the size factors comes the reported permeability, which is
    that of this network; for that of the void itself see `homogenize.permeability`.
    """

    name: ClassVar[str] = "write.network"
    reported: ClassVar[tuple[str, ...]] = (
        "pores", "throats", "closed", "network_k.#3.#3", "network_k_m2.#3.#3", "network_darcy_mean",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (Headline("network_darcy_mean", "k of the network model", "darcy"),)

    path: str = options.write_path("network.csv", suffixes=(".csv", ".npz"))
    resolution: int = options.resolution(96, note="of the grid on which radii are measured", minimum=8, maximum=512)
    cell: Length | None = options.cell(None, note="if the cell has none yet, or another one is wanted")

    def estimate(self, palette: Palette, source: Size) -> Size:
        grid = source.grid(self.resolution)
        return Size(samples=grid.samples, sums=grid.sums, resident=grid.samples, tunnels=source.cell.tunnels)

    def run(self, context: Context, source: Microstructure) -> None:
        """Measure pores and throats, write the file and report the permeability."""
        from sppm_pipeline.features.flow.numerics.pore_network import cut_at_faces, measured, permeability

        edge_mm = source.edge_mm if self.cell is None else self.cell.mm()
        if edge_mm is None:
            raise ConfigError(
                "a pore network is written in meters, but the cell has no physical size", hint="say `cell: 5 mm`"
            )
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
        meters = 1e-3 * edge_mm
        columns = _columns(network, sizes, meters)
        target = context.output(self.path)
        if extension_of(self.path) == ".npz":
            arrays: dict[str, Any] = dict(columns)
            with target.open("wb") as file:
                np.savez_compressed(file, **arrays)
        else:
            target.write_text(_table(columns), encoding="utf-8")
        context.report(
            pores=len(network.coords), throats=len(network.conns), closed=int(np.count_nonzero(~is_open)),
            length_unit="m", model="Hagen-Poiseuille flow in the throats of a network", network_k=k.tolist(),
            network_k_m2=(k * meters**2).tolist(), network_darcy_mean=float(np.trace(k)) / 3 * meters**2 / DARCY,
        )  # fmt: skip


def _columns(network: CutNetwork, sizes: Measured, meters: float) -> dict[str, NDArray[np.generic]]:
    """The arrays of the file, by the names that OpenPNM gives them."""
    from sppm_pipeline.features.flow.numerics.pore_network import MIN_LENGTH

    length = np.linalg.norm(network.vectors, axis=1)
    # OpenPNM takes the length of a throat without its pores
    outside = np.maximum(length - sizes.pore_radius[network.conns].sum(1), MIN_LENGTH * length)
    sides = {
        f"pore.{axis}{side}": np.abs(network.coords[:, number] - place) < 1e-9
        for number, axis in enumerate("xyz")
        for side, place in (("min", 0.0), ("max", 1.0))
    }
    return {
        "pore.coords": network.coords * meters,
        "pore.inscribed_diameter": 2 * sizes.pore_radius * meters,
        "pore.volume": sizes.pore_volume * meters**3,
        "pore.image_of": network.image_of,
        **sides,
        "throat.conns": network.conns,
        "throat.tunnel": network.tunnel,
        "throat.inscribed_diameter": 2 * sizes.throat_radius * meters,
        "throat.length": outside * meters,
        "throat.total_length": length * meters,
        "throat.hydraulic_size_factors": sizes.size_factor * meters**3,
    }


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
