"""Beam lattices, read back by lib3mf: every tunnel, where it was, as thick as was asked for."""

from __future__ import annotations

import lib3mf
import numpy as np
import pytest
from sppm_lib3mf.beams import WriteBeams

import sppm_pipeline as sppm
from sppm_pipeline import ConfigError, Length, PoreSet, TunnelGraph
from sppm_pipeline.testing.plain_context import PlainContext

CENTERS = [[0.5, 2.5, 2.5], [4.5, 2.0, 2.5], [2.0, 4.0, 1.0]]


def cell(edge: str | None = "5 mm") -> TunnelGraph:
    """Three pores of a periodic cell, two tunnels within it and one across its low face of x."""
    centers = np.array(CENTERS) / (1 if edge else 5)
    return TunnelGraph.from_arrays(PoreSet.from_array(centers, edge=edge), [[0, 2], [1, 2], [0, 1]],
                                   [[0, 0, 0], [0, 0, 0], [-1, 0, 0]])  # fmt: skip


def read(path):
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.ReadFromFile(str(path))
    assert reader.GetWarningCount() == 0
    objects = model.GetMeshObjects()
    assert objects.MoveNext()
    mesh = objects.GetCurrentMeshObject()
    points = np.array([list(vertex.Coordinates) for vertex in mesh.GetVertices()])
    beams = mesh.BeamLattice().GetBeams()
    return points, [list(beam.Indices) for beam in beams], [list(beam.Radii) for beam in beams]


@pytest.mark.parametrize("copies", [(1, 1, 1), (3, 2, 1)])
def test_lib3mf_reads_every_beam(copies, tmp_path):
    graph, data = cell(), []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        context = PlainContext(directory=tmp_path / folder)
        WriteBeams(diameter=Length(0.6), copies=copies).run(context, graph)
        data.append((tmp_path / folder / "beams.3mf").read_bytes())
    points, beams, radii = read(tmp_path / "one" / "beams.3mf")
    start, end = (5 * ends for ends in graph.segments(slice(None)))
    cells = np.stack(np.meshgrid(*map(np.arange, copies), indexing="ij"), -1).reshape(-1, 3)
    wanted = {tuple(sorted((tuple(np.round(a + 5 * c, 4)), tuple(np.round(b + 5 * c, 4)))))
              for c in cells for a, b in zip(start, end, strict=True)}  # fmt: skip
    found = {tuple(sorted((tuple(np.round(points[a], 4)), tuple(np.round(points[b], 4))))) for a, b in beams}
    assert found == wanted
    assert len(beams) == len(wanted) == 3 * len(cells) == context.reported["beams"]
    # copies meet in one node: none of them is written twice
    assert len(np.unique(np.round(points, 6), axis=0)) == len(points) == context.reported["nodes"]
    assert np.allclose(radii, 0.3)
    assert context.reported["length_mm"] == pytest.approx(len(cells) * np.linalg.norm(end - start, axis=1).sum())


def test_what_is_no_cell_of_a_size_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="no size in millimeters"):
        WriteBeams(diameter=Length(0.6)).run(PlainContext(directory=tmp_path), cell(None))
    tiles = sppm.tileset.wang_3color(recipe=[
        {"stage": "sample.mirrored_faces", "count": 3, "spacing": 0.2, "edge": "5 mm"},
        {"stage": "sample.dart_throwing", "count": 5, "spacing": 0.2}, {"stage": "connect.mst"},
        {"stage": "field.gaussian", "pore_radius": 0.14, "tunnel_radius": 0.05},
    ], seed=1)  # fmt: skip
    with pytest.raises(ConfigError, match="tile set"):
        WriteBeams(diameter=Length(0.6)).run(PlainContext(directory=tmp_path), tiles.micro)
