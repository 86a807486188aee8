"""Base of the samplers of this package: the smallest distance of the pores is measured and reported."""

from __future__ import annotations

from dataclasses import dataclass

from sppm_pipeline import Context, PoreSet, Sampler


@dataclass(frozen=True, kw_only=True)
class MeasuredSampler(Sampler):
    """Base of samplers that are given no spacing and so have to measure it."""

    def run(self, context: Context, pores: PoreSet | None) -> PoreSet:
        """Throw the pores of all interiors and report the smallest distance of two pores of one interior."""
        from sppm_pipeline.numerics import smallest_spacing as min_spacing

        thrown = super().run(context, pores)
        periodic = (not thrown.has_faces,) * 3
        closest = min(min_spacing(thrown.of_piece(t), periodic) for t in range(thrown.interiors))
        if closest < float("inf"):  # a single pore between faces has no neighbor in its interior
            context.report(smallest_distance=closest)
        return thrown
