"""``field.elastic_texture``: trusses of cubic symmetry, some of them nearly isotropic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, FieldMaker, Length, Palette, ScalarField, Size, option
from sppm_structures.struts import StrutField, size_of_struts
from sppm_structures.textures import TEXTURES, Texture, read_pattern, read_weights, texture_graph

LARGEST_RADIUS = 0.25
"""Edges of a copy; thicker struts leave no void."""


@dataclass(frozen=True, kw_only=True)
class ElasticTexture(FieldMaker):
    """A truss given by a graph in one tetrahedron, mirrored by the 48 symmetries of the cube.

    After Panetta et al. 2015, "Elastic textures for additive fabrication". The tetrahedron has its corners at the
    cube's center c, a face's center f, an edge's middle e and a corner v of the cube. Nodes are named by the corners
    that they lie between: c, cf, cfe, cfev and so on, 15 kinds. A pattern lists edges: ``c-ev ev-f``. Their place
    between the corners is given by barycentric weights, ``ev=1:2``; struts are cones with a radius for each node,
    ``ev=1.5`` times `radius`; joints are blended as in `field.struts`. The publication numbers its patterns; those here
    are named by their edges, and it is not verified which presets are theirs.

    ``tune.porosity`` adds the same to all radii. The presets are isotropic at the density that the README states.
    """

    name: ClassVar[str] = "field.elastic_texture"

    preset: str = option(
        "braced_frame", help="pattern, weights and radii, unless there is a `pattern`", choices=tuple(TEXTURES)
    )
    pattern: str | None = option(None, help="edges of a pattern of one's own, such as `c-ev ev-f`")
    weights: str = option("", help="weights of the pattern's nodes, such as `ev=1:2`; equal where there are none")
    radii: str = option("", help="radii at the pattern's nodes over `radius`, such as `ev=1.5`; 1 where there are none")
    radius: Length = option(Length(0.05), help="radius of the struts", unit="cell size", above=0)
    blend: Length = option(Length(0.02), help="length over which joints are rounded", unit="cell size", minimum=0)
    repeat: int = option(1, help="periods along an edge of the cell", minimum=1, maximum=64)

    def check_options(self) -> None:
        self._texture()

    def _texture(self) -> Texture:
        if self.pattern is None:
            if self.weights or self.radii:
                raise ConfigError("`weights` and `radii` belong to a `pattern`; a preset has its own")
            return TEXTURES[self.preset]
        edges = read_pattern(self.pattern)
        nodes = {node for edge in edges for node in edge}
        sizes = read_weights(self.radii, "radii", nodes, True)
        return Texture(
            edges,
            read_weights(self.weights, "weights", nodes, False),
            {node: size for node, (size,) in sizes.items()},
        )

    def estimate(self, palette: Palette) -> Size:
        graph, blend = texture_graph(self._texture()), self.in_cells(self.blend)
        return size_of_struts(self.edge_mm, graph, self.in_cells(self.radius), blend, self.repeat)

    def run(self, context: Context) -> ScalarField:
        """Mirror the graph; the field is evaluated where it is sampled."""
        texture = self._texture()
        radius, blend = self.in_cells(self.radius), self.in_cells(self.blend)
        thickest, most = radius * max([1.0, *texture.radii.values()]), LARGEST_RADIUS / self.repeat
        if not (thickest < most and blend < most):
            raise ConfigError(
                f"the thickest radius {thickest:g} and the blend {blend:g} must be less than {most:g} cell sizes"
            )
        graph = texture_graph(texture)
        return StrutField(
            lattice=" ".join("-".join(ends) for ends in texture.edges),
            starts=graph.starts,
            ends=graph.ends,
            radii=np.column_stack([graph.start_radii, graph.end_radii]),
            radius=radius,
            blend=blend,
            repeat=self.repeat,
            edge=self.edge_mm,
        )
