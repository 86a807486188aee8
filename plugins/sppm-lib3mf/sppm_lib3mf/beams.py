"""``write.3mf_beams``: a graph as the beam lattice of a 3MF file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, Length, Microstructure, Palette, Size, Stage, TunnelGraph, option

MAX_BEAMS = 2_000_000
"""Beams of a file: the library holds about 300 bytes for each."""


@dataclass(frozen=True, kw_only=True)
class WriteBeams(Stage):
    """Write the tunnels of a cell as beams of one diameter, the struts of a lattice: 3MF beam lattice extension 1.2.

    It is the graph that becomes solid, not the structure around it. Beams end round, and meet where pores are. Copies
    of the cell are laid side by side; beams that leave the last one along an axis end at the pore beyond.
    """

    name: ClassVar[str] = "write.3mf_beams"

    path: str = option("beams.3mf", help="file or folder to write", output=True, suffixes=(".3mf",))
    diameter: Length = option(help="of the beams", unit="mm", minimum=1e-3, maximum=1e3)
    copies: tuple[int, int, int] = option((1, 1, 1), help="of the cell along x, y, z", minimum=1, maximum=1000)

    def estimate(self, palette: Palette, source: Size) -> Size:
        return Size()

    def run(self, context: Context, source: TunnelGraph | Microstructure) -> None:
        """Lay the copies, and write them."""
        import lib3mf

        graph = source.graph if isinstance(source, Microstructure) else source
        pores = graph.pores
        if not pores.cell.physical:
            raise ConfigError("the cell has no size in millimeters", hint="give the sampler `edge`, such as 5 mm")
        if pores.interiors > 1 or max(pores.colors) > 1:
            raise ConfigError("beams are written of one cell, and this is a tile set", hint="wire the graph of a cell")
        count = int(np.prod(self.copies)) * len(graph.edges)
        if not 0 < count <= MAX_BEAMS:
            raise ConfigError(f"{count} beams; a file has 1 to {MAX_BEAMS}", hint="change `copies`, or the cell")
        cells = np.stack(np.meshgrid(*map(np.arange, self.copies), indexing="ij"), -1).reshape(-1, 1, 3)
        nodes = len(pores.centers)
        first, second = graph.edges.astype(np.int64).T
        # which pore of which cell: rows that are equal are one node
        starts = np.concatenate([np.broadcast_to(cells, (len(cells), len(first), 3)).reshape(-1, 3),
                                 (cells + graph.shift).reshape(-1, 3)])  # fmt: skip
        which = np.concatenate([np.tile(first, len(cells)), np.tile(second, len(cells))])
        rows, inverse = np.unique(np.column_stack([starts, which]), axis=0, return_inverse=True)
        points = (rows[:, :3] + pores.centers[rows[:, 3]]) * pores.cell.edge
        ends = inverse.reshape(2, -1).T

        model = lib3mf.get_wrapper().CreateModel()
        model.SetUnit(lib3mf.ModelUnit.MilliMeter)
        mesh = model.AddMeshObject()
        mesh.SetName(context.output(self.path).stem)
        for point in points.tolist():
            mesh.AddVertex(lib3mf.Position(tuple(point)))
        lattice = mesh.BeamLattice()
        lattice.SetMinLength(1e-4)
        radius, round_end = self.diameter.mm() / 2, int(lib3mf.BeamLatticeCapMode.Sphere)
        lattice.SetBeams([lib3mf.Beam((a, b), (radius, radius), (round_end, round_end)) for a, b in ends.tolist()])
        model.AddBuildItem(mesh, lib3mf.get_wrapper().GetIdentityTransform())
        context.output(self.path).write_bytes(bytes(model.QueryWriter("3mf").WriteToBuffer()))
        length = float(np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1).sum())
        context.report(beams=count, nodes=len(points), pores=nodes, length_mm=length)
