"""The structures that stochastic porous microstructures are compared with, as stages of sppm_pipeline."""

from __future__ import annotations

from sppm_pipeline import hookimpl

__all__ = ["sppm_stages"]


@hookimpl
def sppm_stages() -> dict[str, str]:
    """Our stages, by the place of their class, which is imported only when it is used."""
    return {
        "field.tpms": "sppm_structures.tpms:Tpms",
        "field.elastic_texture": "sppm_structures.elastic_texture:ElasticTexture",
        "field.organic": "sppm_structures.organic:Organic",
        "field.spinodoid": "sppm_structures.spinodoid:Spinodoid",
        "field.stochastic_gyroid": "sppm_structures.stochastic_gyroid:StochasticGyroid",
        "field.voronoi_foam": "sppm_structures.voronoi_foam:Voronoi",
        "field.struts": "sppm_structures.struts:Struts",
    }
