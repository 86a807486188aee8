"""Independent extractor for tests of `marching_cubes`: scikit-image's, after Lewiner et al. (2003)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ResourceError
from sppm_pipeline.services.mesh.marching_cubes import Mesh


def marching_cubes_reference(
    field: NDArray[np.float32],
    level: float = 0.0,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Mesh:
    """Isosurface of (nz, ny, nx) samples by scikit-image: vertices (n, 3), faces (m, 3), wound outwards.

    Ambiguous faces are decided by the trilinear interpolant instead. Samples equal to the level are raised to the next
    float32 above, where scikit-image would open edges. ResourceError if scikit-image is not installed.
    """
    try:
        from skimage.measure import marching_cubes
    except ImportError as error:
        raise ResourceError(
            "the reference extractor needs scikit-image", hint='pip install "sppm-pipeline[reference]"'
        ) from error
    samples = np.ascontiguousarray(field, np.float32)
    level32 = np.float32(level)
    if not samples.min() < level32 <= samples.max():
        return np.empty((0, 3)), np.empty((0, 3), np.int32)  # scikit-image refuses a field without surface
    samples = np.where(samples == level32, np.nextafter(level32, np.float32(np.inf)), samples)
    vertices, faces, _, _ = marching_cubes(  # type: ignore[no-untyped-call]
        samples, float(level32), gradient_direction="ascent", allow_degenerate=True
    )
    # In z, y, x taken as a right-handed frame these faces look into the solid; taken as x, y, z they are mirrored.
    positions = np.asarray(origin) + vertices[:, ::-1].astype(np.float64) * np.asarray(spacing)
    return positions, np.ascontiguousarray(faces, np.int32)
