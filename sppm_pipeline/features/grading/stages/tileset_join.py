"""``tileset.join``: two tile sets that will be laid in one part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import ConfigError, Context, Palette, Size, Stage, TileSet
from sppm_pipeline.features.grading.joined import JoinedSets

MAX_PER_EDGE = 8
"""Maximum number of small cells along the edge of a large one: 512 of them then fill one, and a part of
both would be all of one kind or the other."""

KINDS = ("free", "wang", "corner")


@dataclass(frozen=True, kw_only=True)
class JoinTileSets(Stage):
    """Take two tile sets together, which `tile.joined` then lays side by side; neither is changed.

    Write ``from: {first: id, second: id}``. The sets may differ in all but the profile of their tunnels. Cells of one
    are as large as those of the other, or a whole number of times larger, as the samplers' `edge` in both recipes says.
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
        return JoinedSets(first, second, self._per_edge(first.micro.edge_mm, second.micro.edge_mm))

    def _per_edge(self, first: float | None, second: float | None) -> tuple[int, int]:
        """Cells of either set along an edge of the larger ones."""
        if first is None or second is None:
            return (1, 1)
        ratio = max(first, second) / min(first, second)
        m = round(ratio)
        if abs(ratio - m) > 1e-6 * ratio or m > MAX_PER_EDGE:
            raise ConfigError(
                f"a cell of the first set is {first:g} mm large, one of the second {second:g} mm; one has to be the "
                f"other one times a whole number up to {MAX_PER_EDGE}",
                hint="change `edge` in the samplers of one recipe, or leave it out for cells of one size",
            )
        return (1, m) if first >= second else (m, 1)
