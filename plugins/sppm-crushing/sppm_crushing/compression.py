"""Compression of a block between plates: the stress-strain curve, tested or simulated, and the deformed body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Report, frozen, number, reports
from sppm_pipeline.nouns import TEXT, Number


@dataclass(frozen=True, eq=False)
class CompressionCurve(Report):
    """Nominal stress over nominal strain of a specimen compressed between plates; both positive in compression.

    Attributes
    ----------
    strain : (n,) float64
        Displacement over undeformed height, in the order of the test: a loop of unloading goes back.
    stress : (n,) float64
        Force over the area of the undeformed specimen, in `unit`.
    unit : str
        "MPa", "GPa", or "relative" (to Young's modulus of the solid).
    origin : str
        "simulated" or "measured".
    name : str
        What charts call it; curves of one name are specimens of one batch.
    area : float or None
        Of the section of the undeformed specimen, mm2.
    height : float or None
        Of the undeformed specimen, mm.
    density : float or None
        Mass over volume of the undeformed specimen, pores included, g/cm3.
    energies : mapping of str to (n,) float64
        Of a simulation, energies per volume of the undeformed specimen, in `unit`: "external" is the work of the
        plates, the others are what has become of it.
    plates : (n, 2) float64 or None
        Of a simulation, the stress at the resting and at the moving plate, in `unit`.
    numbers : mapping of str
        Further numbers of the test or simulation for the run record, JSON-ready.
    notes : tuple of str
        What was read from the file, and what was corrected.
    ended : str
        Why a simulation ended before the strain that it was to reach; empty if it did not.
    """

    strain: NDArray[np.float64]
    stress: NDArray[np.float64]
    unit: str
    origin: str
    name: str = ""
    area: float | None = None
    height: float | None = None
    density: float | None = None
    energies: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    plates: NDArray[np.float64] | None = None

    @reports(
        Number("name", column=False), Number("origin", column=False), "points", "strain_max", "stress_max",
        Number("unit", column=False), "area_mm2", "height_mm", "density_g_cm3", "energies.*",
    )  # fmt: skip
    def _extent(self) -> tuple[Any, ...]:
        """Origin, extent, specimen, and energies at the end of the curve."""
        ends = float(self.strain.max()), float(self.stress.max())
        energies = {name: float(values[-1]) for name, values in self.energies.items()}
        specimen = self.area, self.height, self.density
        return self.name, self.origin, len(self.strain), *ends, self.unit, *specimen, energies

    numbers: Mapping[str, Any] = field(default_factory=dict, metadata=number("*"))
    notes: tuple[str, ...] = field(default=(), metadata=TEXT)
    ended: str = field(default="", metadata=TEXT)

    def __post_init__(self) -> None:
        for name in ("strain", "stress", "plates"):
            value = getattr(self, name)
            object.__setattr__(self, name, value if value is None else frozen(np.asarray(value, np.float64)))
        energies = {name: frozen(np.asarray(values, np.float64)) for name, values in self.energies.items()}
        object.__setattr__(self, "energies", energies)

    def check(self) -> None:
        """Two or more finite points, a known unit and origin, positive sizes, energies and plates at every point."""
        n = len(self.strain)
        if self.strain.ndim != 1 or self.stress.shape != (n,) or n < 2:
            raise ValueError(f"a curve needs two or more points, got {self.strain.shape} and {self.stress.shape}")
        if self.unit not in ("relative", "MPa", "GPa") or self.origin not in ("simulated", "measured"):
            raise ValueError(f"a curve can't be {self.origin!r} in {self.unit!r}")
        if self.plates is not None and self.plates.shape != (n, 2):
            raise ValueError(f"{n} points have stresses at two plates, got {self.plates.shape}")
        for name, values in self.energies.items():
            if values.shape != (n,):
                raise ValueError(f"{n} points have {values.shape} energies {name!r}")
        arrays = [self.strain, self.stress, *self.energies.values(), *([] if self.plates is None else [self.plates])]
        if not all(np.isfinite(values).all() for values in arrays):
            raise ValueError("the numbers of a curve must be finite")
        for name in ("area", "height", "density"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise ValueError(f"the {name} of a specimen must be positive, got {value}")

    @property
    def displacement(self) -> NDArray[np.float64] | None:
        """Way of the moving plate, mm; None if the height is not known."""
        return None if self.height is None else self.height * self.strain

    @property
    def force(self) -> NDArray[np.float64] | None:
        """Force on the specimen, N; None if the area is not known or stresses are relative."""
        factor = {"MPa": 1.0, "GPa": 1000.0}.get(self.unit)
        return None if self.area is None or factor is None else factor * self.area * self.stress


@dataclass(frozen=True, eq=False)
class CrushedBody(CompressionCurve):
    """The curve of a simulated compression, with the deformed voxels at some of its strains.

    Attributes
    ----------
    grid : (nx, ny, nz)
        Voxels of the block, void included.
    spacing : float
        Edge of a voxel, mm, or cell sizes if `physical` is False.
    physical : bool
    axis : str
        "x", "y" or "z", along which it is compressed.
    voxels : (m, 3) int32
        Place of each solid voxel in the grid.
    phases : (m,) uint8
        Its phase, from 1 on.
    elements : (m, 8) int32
        Nodes at its corners; column i + 2 j + 4 k is the corner at the upper end along x, y, z where i, j, k is 1.
    frame_strains : (f,) float64
        Strains of the frames, from small to large.
    frame_nodes : (f, p, 3) float32
        Positions of the nodes in each frame, in the unit of `spacing`, from the lower corner of the undeformed block.
    frame_alpha : (f, m) float32
        Accumulated plastic strain of each voxel in each frame; 0 for an elastic solid.
    frame_released : (f, m) bool
        Which voxels have failed in each frame; (0, 0) where none can.
    """

    grid: tuple[int, int, int] = field(default=(0, 0, 0), metadata=number("#3"))
    spacing: float = 0.0
    physical: bool = True
    axis: str = field(default="z", metadata=TEXT)
    voxels: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    phases: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))
    elements: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 8), np.int32))
    frame_strains: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    frame_nodes: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0, 3), np.float32))
    frame_alpha: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    frame_released: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), bool))

    @reports("voxels", "nodes", "frames.*", "plastic_strain_max")
    def _sizes(self) -> tuple[Any, ...]:
        return len(self.voxels), self.nodes, self.frame_strains.tolist(), float(self.frame_alpha.max())

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, dtype in _BODY.items():
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), dtype)))

    def check(self) -> None:
        """Voxels in the grid, nodes that exist, frames of one shape with finite positions."""
        super().check()
        m, f = len(self.voxels), len(self.frame_strains)
        if self.axis not in ("x", "y", "z") or min(self.grid) < 1 or not 0 < self.spacing < np.inf:
            raise ValueError(f"a block can't have {self.grid} voxels of {self.spacing}, compressed along {self.axis!r}")
        shapes = {
            "voxels": (m, 3), "phases": (m,), "elements": (m, 8), "frame_strains": (f,),
            "frame_nodes": (f, self.nodes, 3), "frame_alpha": (f, m),
            "frame_released": (f, m) if self.frame_released.size else (0, 0),
        }  # fmt: skip
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"`{name}` has shape {getattr(self, name).shape}, expected {shape}")
        if not m or not f:
            raise ValueError(f"a body has voxels and frames, got {m} and {f}")
        if self.voxels.min() < 0 or (self.voxels >= self.grid).any() or self.phases.min() < 1:
            raise ValueError(f"a solid voxel lies outside of the grid {self.grid}, or is void")
        if self.elements.min() < 0 or self.elements.max() >= self.nodes:
            raise ValueError(f"an element names a node that does not exist; there are {self.nodes}")
        if not np.isfinite(self.frame_nodes).all() or not np.isfinite(self.frame_alpha).all():
            raise ValueError("a frame holds numbers that are not finite")
        if (np.diff(self.frame_strains) <= 0).any():
            raise ValueError("the frames must be in the order of their strains")

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return int(self.frame_nodes.shape[1]) if self.frame_nodes.ndim == 3 else 0


_BODY: Mapping[str, Any] = {
    "voxels": np.int32, "phases": np.uint8, "elements": np.int32, "frame_strains": np.float64,
    "frame_nodes": np.float32, "frame_alpha": np.float32, "frame_released": np.bool_,
}  # fmt: skip
