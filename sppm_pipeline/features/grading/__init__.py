"""Grading: parameters that vary in space, bent and joined cells."""

from __future__ import annotations

from sppm_pipeline.hookspecs import hookimpl

STAGES = {
    "read.hexahedra": "ReadHexahedra",
    "grade.formula": "GradeFormula",
    "grade.table": "GradeTable",
    "grade.image": "GradeImage",
    "grade.points": "GradePoints",
    "grade.nodes": "GradeNodes",
    "grade.distance": "GradeDistance",
    "grade.stiffness": "GradeStiffness",
    "field.blend": "BlendFields",
    "tune.local_porosity": "TuneLocalPorosity",
    "tileset.join": "JoinTileSets",
    "tile.graded": "GradedTiling",
    "tile.joined": "JoinedTiling",
    "tile.hexahedra": "HexahedralTiling",
    "warp.affine": "WarpAffine",
    "warp.cylinder": "WarpCylinder",
    "warp.sphere": "WarpSphere",
    "warp.hexahedra": "WarpHexahedra",
    "check.local_porosity": "CheckLocalPorosity",
}
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}
