"""``tileset.join``: two tile sets that will be laid in one part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.fields.joined import JoinedSets
from sppm_pipeline.fields.tileset import TileSet
from sppm_pipeline.stage import Context, Stage

KINDS = ("free", "wang", "corner")


@dataclass(frozen=True, kw_only=True)
class JoinTileSets(Stage):
    """Take two tile sets together, which `tile.joined` then lays side by side; neither is changed.

    Write ``from: {first: id, second: id}``. The sets may differ in all but the profile of their tunnels, and a cell of
    one must be as large as one of the other.
    """

    name: ClassVar[str] = "tileset.join"

    def estimate(self, palette: Palette, first: Size, second: Size) -> Size:
        return first

    def run(self, context: Context, first: TileSet, second: TileSet) -> JoinedSets:
        """Check that they fit."""
        profiles = [tileset.micro.pieces.kernels.profile for tileset in (first, second)]
        if profiles[0] != profiles[1]:
            raise ConfigError(
                f"the tunnels of the first set have the profile {profiles[0]!r}, those of the second {profiles[1]!r}",
                hint="draw both sets with one profile; structures of other kinds are joined by `field.blend`",
            )
        for which, tileset in (("first", first), ("second", second)):
            if tileset.kind not in KINDS or 0 in tileset.micro.colors:
                raise ConfigError(
                    f"the {which} set is of kind {tileset.kind!r} with {list(tileset.micro.colors)} face patterns",
                    hint="join sets of tileset.free_faces, tileset.wang_3color or tileset.corner_colors",
                )
        edges = [tileset.micro.edge_mm for tileset in (first, second)]
        if None not in edges and edges[0] != edges[1]:
            raise ConfigError(
                f"a cell of the first set is {edges[0]:g} mm large, one of the second {edges[1]:g} mm",
                hint="give the samplers of both recipes the same `edge`, or leave it out",
            )
        return JoinedSets(first, second)
