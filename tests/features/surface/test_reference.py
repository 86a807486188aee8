"""Ours against scikit-image's marching cubes."""

import builtins

import numpy as np
import pytest

from sppm_pipeline.errors import ResourceError
from sppm_pipeline.features.surface.stages.extract_marching_cubes import marching_cubes_reference
from sppm_pipeline.services.mesh.marching_cubes import marching_cubes
from sppm_pipeline.services.mesh.measures import edge_counts, measure_surface

ORIGIN, SPACING = (0.5, -2.0, 1.0), (0.1, 0.2, 0.15)


def blobs(seed: int, n: int = 28) -> np.ndarray:
    """A smooth field without ambiguous faces, void at the border."""
    rng = np.random.default_rng(seed)
    z, y, x = np.mgrid[0:n, 0:n, 0:n]
    field = np.full((n, n, n), 0.6)
    for cx, cy, cz in rng.uniform(7, n - 8, (9, 3)):
        field -= np.exp(-((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2) / 14)
    return field.astype(np.float32)


@pytest.mark.parametrize("seed", range(6))
def test_same_surface_of_a_smooth_field(seed: int) -> None:
    field = blobs(seed)
    ours = measure_surface(*marching_cubes(field, 0, ORIGIN, SPACING))
    theirs = measure_surface(*marching_cubes_reference(field, 0, ORIGIN, SPACING))
    assert theirs.edges.closed
    assert (ours.euler, ours.components, ours.vertices) == (theirs.euler, theirs.components, theirs.vertices)
    assert ours.volume == pytest.approx(theirs.volume, rel=3e-3)  # the same polygons, cut by other diagonals
    assert ours.area == pytest.approx(theirs.area, rel=1e-3)
    assert ours.low == pytest.approx(theirs.low, abs=1e-3)


def test_samples_on_the_level_do_not_open_the_reference() -> None:
    field = np.pad(np.random.default_rng(1).integers(-2, 3, (8, 8, 8)), 1, constant_values=1).astype(np.float32)
    assert edge_counts(marching_cubes_reference(field)[1]).unbalanced == 0


def test_no_surface_no_mesh() -> None:
    for value in (-1.0, 0.0, 1.0):
        vertices, faces = marching_cubes_reference(np.full((3, 3, 3), value, np.float32))
        assert vertices.shape == faces.shape == (0, 3)


def test_without_scikit_image_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def absent(name: str, *args: object, **kwargs: object) -> object:
        if name.startswith("skimage"):
            raise ImportError(name)
        return real(name, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(ResourceError, match=r"sppm-pipeline\[reference\]"):
        marching_cubes_reference(blobs(0))
