import numpy as np
import pytest

from sppm_pipeline.method.assembly.contents import check_tiling, lone_periodic_cell


def test_good_tilings(sets) -> None:
    pieces = sets.pieces(0)
    for periodic in (False, True):
        check_tiling(sets.tiling(1, (3, 2, 4), pieces, periodic), pieces)
    check_tiling(lone_periodic_cell(2, (1, 0, 1)), pieces)


def test_bad_tilings(sets) -> None:
    pieces = sets.pieces(0)
    tiling = sets.tiling(1, (3, 2, 4), pieces, holes=0.0)
    with pytest.raises(ValueError, match="faces of axis 1 have the shape"):
        check_tiling(tiling._replace(faces=(tiling.faces[0], tiling.faces[0], tiling.faces[2])))
    with pytest.raises(ValueError, match="first and last faces"):
        check_tiling(tiling._replace(periodic=True))
    with pytest.raises(ValueError, match="interior 7, of 3"):
        check_tiling(tiling._replace(interior=np.full_like(tiling.interior, 7)), pieces)
    faces = (tiling.faces[0], np.full_like(tiling.faces[1], 5), tiling.faces[2])
    with pytest.raises(ValueError, match="color 5, of 2"):
        check_tiling(tiling._replace(faces=faces), pieces)
