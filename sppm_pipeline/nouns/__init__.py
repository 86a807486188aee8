"""The nouns: what passes between stages, what these are made of, and what hooks hand over.

A public sub-face of the package: names here stay, and are loaded when they are first used. What the engine
knows itself (artifacts, lengths, palettes, reports, sizes, tables) are modules of this package.
"""

from __future__ import annotations

from sppm_pipeline import lazily

TYPE_CHECKING = False  # as type checkers understand it
if TYPE_CHECKING:  # the same names as in `_PLACES`, which a test compares
    from sppm_pipeline.engine.api.bound_stage import BoundStage as BoundStage
    from sppm_pipeline.engine.process import ArraySpec as ArraySpec
    from sppm_pipeline.engine.process import NativeResult as NativeResult
    from sppm_pipeline.engine.process.interruption import Stop as Stop
    from sppm_pipeline.features.crushing.compression import CompressionCurve as CompressionCurve
    from sppm_pipeline.features.crushing.compression import CrushedBody as CrushedBody
    from sppm_pipeline.features.flow.acoustics import AcousticReport as AcousticReport
    from sppm_pipeline.features.flow.conductivity import ConductivityReport as ConductivityReport
    from sppm_pipeline.features.flow.numerics.acoustics import PoreParameters as PoreParameters
    from sppm_pipeline.features.flow.permeability import PermeabilityReport as PermeabilityReport
    from sppm_pipeline.features.grading.maps import CellFrame as CellFrame
    from sppm_pipeline.features.grading.maps import Grading as Grading
    from sppm_pipeline.features.grading.maps import Law as Law
    from sppm_pipeline.features.grading.maps import Place as Place
    from sppm_pipeline.hookspecs import Command as Command
    from sppm_pipeline.hookspecs import Comparison as Comparison
    from sppm_pipeline.hookspecs import Preset as Preset
    from sppm_pipeline.hookspecs import StageEvent as StageEvent
    from sppm_pipeline.method.families.cloud import Cloud as Cloud
    from sppm_pipeline.method.families.cloud import Piece as Piece
    from sppm_pipeline.method.families.homogenizer import VoxelCell as VoxelCell
    from sppm_pipeline.method.families.interiors import InteriorBox as InteriorBox
    from sppm_pipeline.method.families.interiors import Interiors as Interiors
    from sppm_pipeline.method.families.layer_writer import EncodedLayers as EncodedLayers
    from sppm_pipeline.method.families.layer_writer import LayerObserver as LayerObserver
    from sppm_pipeline.method.families.tiler import Lattice as Lattice
    from sppm_pipeline.method.fields.formula import CellCache as CellCache
    from sppm_pipeline.method.fields.formula import CellIndex as CellIndex
    from sppm_pipeline.method.fields.formula import CellwiseField as CellwiseField
    from sppm_pipeline.method.fields.formula import FormulaField as FormulaField
    from sppm_pipeline.method.fields.formula import PlacedField as PlacedField
    from sppm_pipeline.method.fields.microstructure import PeriodicTile as PeriodicTile
    from sppm_pipeline.method.fields.scalar_field import WrappedField as WrappedField
    from sppm_pipeline.method.nouns.cell_sizes import CellSizes as CellSizes
    from sppm_pipeline.method.nouns.mesh import RepeatedMesh as RepeatedMesh
    from sppm_pipeline.method.nouns.printer import Motion as Motion
    from sppm_pipeline.method.nouns.printer import Printer as Printer
    from sppm_pipeline.method.nouns.stiffness import StiffnessReport as StiffnessReport
    from sppm_pipeline.method.part.border import Border as Border
    from sppm_pipeline.method.sampling.many import Surrounding as Surrounding
    from sppm_pipeline.method.slicing.slice_stack import Slab as Slab
    from sppm_pipeline.method.slicing.slice_stack import Slabs as Slabs
    from sppm_pipeline.method.tiling.lattice import Laid as Laid
    from sppm_pipeline.nouns.artifact import Surface as Surface
    from sppm_pipeline.nouns.palette import Blocks as Blocks
    from sppm_pipeline.nouns.palette import KeptPores as KeptPores
    from sppm_pipeline.nouns.report import TEXT as TEXT
    from sppm_pipeline.nouns.report import Box as Box
    from sppm_pipeline.nouns.report import Chart as Chart
    from sppm_pipeline.nouns.report import Curve as Curve
    from sppm_pipeline.nouns.report import Number as Number
    from sppm_pipeline.nouns.report import ReportSection as ReportSection
    from sppm_pipeline.nouns.report import is_number as is_number
    from sppm_pipeline.nouns.size import CellDesign as CellDesign
    from sppm_pipeline.nouns.size import Geometry as Geometry
    from sppm_pipeline.nouns.table import RunFile as RunFile
    from sppm_pipeline.nouns.viewers import Viewer as Viewer
    from sppm_pipeline.stage import Observed as Observed
    from sppm_pipeline.stage import StageAlias as StageAlias

_PLACES = {
    "engine.api.bound_stage": "BoundStage",
    "engine.process": "ArraySpec NativeResult",
    "engine.process.interruption": "Stop",
    "features.crushing.compression": "CompressionCurve CrushedBody",
    "features.flow.acoustics": "AcousticReport",
    "features.flow.conductivity": "ConductivityReport",
    "features.flow.numerics.acoustics": "PoreParameters",
    "features.flow.permeability": "PermeabilityReport",
    "features.grading.maps": "CellFrame Grading Law Place",
    "hookspecs": "Command Comparison Preset StageEvent",
    "method.families.cloud": "Cloud Piece",
    "method.families.homogenizer": "VoxelCell",
    "method.families.interiors": "InteriorBox Interiors",
    "method.families.layer_writer": "EncodedLayers LayerObserver",
    "method.families.tiler": "Lattice",
    "method.fields.formula": "CellCache CellIndex CellwiseField FormulaField PlacedField",
    "method.fields.microstructure": "PeriodicTile",
    "method.fields.scalar_field": "WrappedField",
    "method.nouns.cell_sizes": "CellSizes",
    "method.nouns.mesh": "RepeatedMesh",
    "method.nouns.printer": "Motion Printer",
    "method.nouns.stiffness": "StiffnessReport",
    "method.part.border": "Border",
    "method.sampling.many": "Surrounding",
    "method.slicing.slice_stack": "Slab Slabs",
    "method.tiling.lattice": "Laid",
    "nouns.artifact": "Surface",
    "nouns.palette": "Blocks KeptPores",
    "nouns.report": "Box Chart Curve Number ReportSection TEXT is_number",
    "nouns.size": "CellDesign Geometry",
    "nouns.table": "RunFile",
    "nouns.viewers": "Viewer",
    "stage": "Observed StageAlias",
}
"""Modules below `sppm_pipeline`, and what is taken from each: ``name``, or ``public name=name there``."""

__all__, __getattr__, __dir__ = lazily(__name__, _PLACES)
