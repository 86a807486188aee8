# What the module of this name loads when it is first used (`sppm_pipeline.lazily`), and type checkers read.
from sppm_pipeline.method.assembly.contents import PieceNumbers as PieceNumbers
from sppm_pipeline.method.assembly.contents import Pieces as Pieces
from sppm_pipeline.method.assembly.contents import TilingArrays as TilingArrays
from sppm_pipeline.method.assembly.gather import Catalog as Catalog
from sppm_pipeline.method.assembly.gather import make_catalog as make_catalog
from sppm_pipeline.method.assembly.gather import sample_exact as sample_exact
from sppm_pipeline.method.connectivity.components import Components as Components
from sppm_pipeline.method.connectivity.components import PhaseReport as PhaseReport
from sppm_pipeline.method.connectivity.components import find_components as find_components
from sppm_pipeline.method.connectivity.components import paint_runs as paint_runs
from sppm_pipeline.method.connectivity.components import phase_report as phase_report
from sppm_pipeline.method.connectivity.removal import report_removal as report_removal
from sppm_pipeline.method.connectivity.runs import Runs as Runs
from sppm_pipeline.method.families.homogenizer import grids_below as grids_below
from sppm_pipeline.method.families.homogenizer import per_phase as per_phase
from sppm_pipeline.method.families.homogenizer import refined as refined
from sppm_pipeline.method.families.tiler import lattice_for as lattice_for
from sppm_pipeline.method.kernels.kernels import Kernels as Kernels
from sppm_pipeline.method.kernels.profiles import TUNNEL_PROFILES as TUNNEL_PROFILES
from sppm_pipeline.method.kernels.profiles import omega_from_radius as omega_from_radius
from sppm_pipeline.method.porosity.fractions import solid_fractions as solid_fractions
from sppm_pipeline.method.sampling.capacity import largest_spacing as largest_spacing
from sppm_pipeline.method.sampling.capacity import min_spacing as _smallest_spacing
from sppm_pipeline.method.sampling.darts import throw as _throw_darts
from sppm_pipeline.method.tiling.corners import tile_corners as tile_corners
from sppm_pipeline.method.tiling.hashed import tile_hashed as tile_hashed
from sppm_pipeline.method.tiling.lattice import hash_places as hash_places
from sppm_pipeline.services.arrays import F32 as F32
from sppm_pipeline.services.arrays import F64 as F64
from sppm_pipeline.services.arrays import I32 as I32
from sppm_pipeline.services.arrays import I64 as I64
from sppm_pipeline.services.arrays import U8 as U8
from sppm_pipeline.services.arrays import U64 as U64
from sppm_pipeline.services.arrays import Bools as Bools
from sppm_pipeline.services.elastic.bounds import Bounds as Bounds
from sppm_pipeline.services.elastic.bounds import Interval as Interval
from sppm_pipeline.services.elastic.convergence import Limit as Limit
from sppm_pipeline.services.elastic.elastic_level import Moduli as Moduli
from sppm_pipeline.services.elastic.loaded import HeldBody as HeldBody
from sppm_pipeline.services.elastic.loaded import Loaded as Loaded
from sppm_pipeline.services.elastic.loaded import NodalValues as NodalValues
from sppm_pipeline.services.grid import VOXEL_FACES as VOXEL_FACES
from sppm_pipeline.services.grid import Grid as Grid
from sppm_pipeline.services.grid import cell_centers as cell_centers
from sppm_pipeline.services.grid import cell_nodes as cell_nodes
from sppm_pipeline.services.jit.compiled import inline_jit as inline_jit
from sppm_pipeline.services.jit.compiled import jit as jit
from sppm_pipeline.services.mesh.closing import wrapped as _closed_across
from sppm_pipeline.services.mesh.marching_cubes import marching_cubes as marching_cubes
from sppm_pipeline.services.mesh.measures import EdgeCounts as EdgeCounts
from sppm_pipeline.services.mesh.measures import SurfaceMeasures as SurfaceMeasures
from sppm_pipeline.services.mesh.measures import components as _mesh_components
from sppm_pipeline.services.mesh.measures import edge_counts as _mesh_edges
from sppm_pipeline.services.mesh.measures import measure_surface as _mesh_measures
from sppm_pipeline.services.mesh.measures import surface_area as _mesh_area
from sppm_pipeline.services.mesh.measures import volume as _mesh_volume
from sppm_pipeline.services.mesh.rotation import rotated as rotated
from sppm_pipeline.services.mesh.rotation import rotation as rotation
from sppm_pipeline.services.multigrid.hierarchy import Hierarchy as Hierarchy
from sppm_pipeline.services.multigrid.hierarchy import Level as Level
from sppm_pipeline.services.multigrid.hierarchy import Transfer as Transfer
from sppm_pipeline.services.multigrid.hierarchy import Workspace as Workspace
from sppm_pipeline.services.multigrid.hierarchy import coarser as coarser
from sppm_pipeline.services.multigrid.hierarchy import node_sums as node_sums
from sppm_pipeline.services.multigrid.hierarchy import padded as padded
from sppm_pipeline.services.multigrid.rows import APPLY as APPLY
from sppm_pipeline.services.multigrid.rows import BLOCK as BLOCK
from sppm_pipeline.services.multigrid.rows import HEAD as HEAD
from sppm_pipeline.services.multigrid.rows import LANES as LANES
from sppm_pipeline.services.multigrid.rows import RESIDUAL as RESIDUAL
from sppm_pipeline.services.multigrid.rows import SMOOTH as SMOOTH
from sppm_pipeline.services.multigrid.rows import STRIDE as STRIDE
from sppm_pipeline.services.multigrid.rows import finish_row as finish_row
from sppm_pipeline.services.multigrid.rows import gather_row as gather_row
from sppm_pipeline.services.multigrid.rows import scatter_row as scatter_row
from sppm_pipeline.services.multigrid.solver import Measure as Measure
from sppm_pipeline.services.multigrid.solver import Solved as Solved
from sppm_pipeline.services.multigrid.solver import Stop as _SolverStop
from sppm_pipeline.services.multigrid.solver import load_cases as load_cases
from sppm_pipeline.services.multigrid.solver import solve as solve
from sppm_pipeline.services.multigrid.transfer import coarsened as coarsened
from sppm_pipeline.services.multigrid.transfer import coarser_widths as coarser_widths
from sppm_pipeline.services.multigrid.transfer import shortness as shortness
from sppm_pipeline.services.multigrid.vectors import dense_product as dense_product
from sppm_pipeline.services.multigrid.vectors import dot as dot
from sppm_pipeline.services.multigrid.vectors import weighted as weighted
from sppm_pipeline.services.outlines import level_lines as level_lines
from sppm_pipeline.services.outlines import outlines as outlines
from sppm_pipeline.services.threads import ordered_map as ordered_map

SolverStop = _SolverStop
closed_across = _closed_across
mesh_area = _mesh_area
mesh_components = _mesh_components
mesh_edges = _mesh_edges
mesh_measures = _mesh_measures
mesh_volume = _mesh_volume
smallest_spacing = _smallest_spacing
throw_darts = _throw_darts
