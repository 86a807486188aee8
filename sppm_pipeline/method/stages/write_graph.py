"""``write.graph``: pores and tunnels as a graph file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, Microstructure, Palette, Size, Stage, TunnelGraph, options
from sppm_pipeline.method.families.file_writer import extension_of


@dataclass(frozen=True, kw_only=True)
class WriteGraph(Stage):
    """Write pores and tunnels as GraphML or node-link JSON, and report degrees, bridges and loops.

    Coordinates and lengths are in cell sizes, as the attribute ``length_unit`` of the graph says; ``cell_size_mm`` is
    there if the cell has a size. A tunnel with the attribute ``shift`` leads from the pore with the lower number to the
    image of the other one that is so many cells away, whatever the order in which a reader lists the two.
    """

    name: ClassVar[str] = "write.graph"
    libraries: ClassVar[tuple[str, ...]] = ("networkx",)

    path: str = options.write_path("graph.graphml", suffixes=(".graphml", ".json"))

    def estimate(self, palette: Palette, source: Size) -> Size:
        return Size(pores=source.cell.pores, tunnels=source.cell.tunnels)

    def run(self, context: Context, source: TunnelGraph | Microstructure) -> None:
        """Write the file."""
        import networkx

        from sppm_pipeline.method.connecting.statistics import graph_statistics, networkx_graph

        graph = source.graph if isinstance(source, Microstructure) else source
        pores = graph.pores
        axis = pores.axis_of_piece()[pores.piece]
        region = ["interior" if a < 0 else f"face_{'xyz'[a]}" for a in axis]
        exported = networkx_graph(pores.centers, graph.edges, graph.shift, region)
        exported.graph["length_unit"] = "cell size"
        if pores.cell.physical:
            exported.graph["cell_size_mm"] = pores.cell.edge
        target = context.output(self.path)
        if extension_of(self.path) == ".json":
            text = json.dumps(networkx.node_link_data(exported, edges="edges"), indent=1, sort_keys=True)
            target.write_text(text + "\n", encoding="utf-8")
        else:
            networkx.write_graphml_xml(exported, target)  # not by lxml where that is installed: other bytes
        context.report(**graph_statistics(pores.centers, graph.edges, graph.shift)._asdict())
