"""Functions of the child process: MeshLab's filters on arrays. MeshLab never sees a file.

Its readers hang on an STL whose header lies about the number of triangles, and die of an OBJ that names a vertex it
does not have; the arrays handed over here have been checked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import notify

Arrays = Mapping[str, NDArray[Any]]
Options = Mapping[str, Any]


def apply(arrays: Arrays, options: Options) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Run one of the filters below, named by ``options["filter"]``, and return the mesh it leaves."""
    import pymeshlab

    name = options["filter"]
    notify(name.replace("_", " "))
    meshes = _loaded(pymeshlab, arrays)
    try:
        _FILTERS[name](pymeshlab, meshes, options)
    except pymeshlab.PyMeshLabException as error:
        return _empty(), {"refused": " ".join(str(error).replace("<br>", " ").split())[:400]}
    mesh = meshes.current_mesh()
    if mesh.vertex_number() == 0 or mesh.face_number() == 0:
        return _empty(), {"refused": "nothing was left"}
    vertices, faces = mesh.vertex_matrix(), mesh.face_matrix()
    return {"vertices": np.array(vertices, np.float64), "faces": np.array(faces, np.int32)}, {}


def count_self_intersections(arrays: Arrays, options: Options) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Number of triangles that pass through another one."""
    import pymeshlab

    notify("look for self-intersections")
    meshes = _loaded(pymeshlab, arrays)
    meshes.compute_selection_by_self_intersections_per_face()
    return {}, {"triangles": int(meshes.current_mesh().selected_face_number())}


def _loaded(pymeshlab: Any, arrays: Arrays) -> Any:
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(arrays["vertices"], arrays["faces"]))
    return meshes


def _empty() -> dict[str, NDArray[Any]]:
    return {"vertices": np.zeros((0, 3)), "faces": np.zeros((0, 3), np.int32)}


def _clean(pymeshlab: Any, meshes: Any, options: Options) -> None:
    meshes.meshing_remove_duplicate_faces()
    meshes.meshing_remove_null_faces()
    meshes.meshing_remove_unreferenced_vertices()


def _merge(pymeshlab: Any, meshes: Any, options: Options) -> None:
    meshes.meshing_merge_close_vertices(threshold=pymeshlab.PureValue(options["distance"]))
    _clean(pymeshlab, meshes, options)


def _split(pymeshlab: Any, meshes: Any, options: Options) -> None:
    # faces are kept where that is possible: those removed have to be filled in again, by guessing
    for method in ("Split Vertices", "Remove Faces"):
        if meshes.get_topological_measures()["non_two_manifold_edges"]:
            meshes.meshing_repair_non_manifold_edges(method=method)
    meshes.meshing_repair_non_manifold_vertices()


def _orient(pymeshlab: Any, meshes: Any, options: Options) -> None:
    meshes.meshing_re_orient_faces_coherently()


def _close(pymeshlab: Any, meshes: Any, options: Options) -> None:
    # patches that pass through the mesh are avoided where that is possible, and accepted where it is not
    for avoid in (True, False):
        meshes.meshing_close_holes(maxholesize=options["edges"], selfintersection=avoid)


def _unite(pymeshlab: Any, meshes: Any, options: Options) -> None:
    meshes.generate_boolean_union(first_mesh=0, second_mesh=0)
    meshes.meshing_remove_unreferenced_vertices()


def _wrap(pymeshlab: Any, meshes: Any, options: Options) -> None:
    meshes.generate_alpha_wrap(alpha=pymeshlab.PureValue(options["gap"]), offset=pymeshlab.PureValue(options["offset"]))


def _remesh(pymeshlab: Any, meshes: Any, options: Options) -> None:
    meshes.meshing_isotropic_explicit_remeshing(
        targetlen=pymeshlab.PureValue(options["edge"]),
        iterations=options["iterations"],
        featuredeg=options["feature_angle"],
        adaptive=options["adaptive"],
        checksurfdist=True,
        maxsurfdist=pymeshlab.PureValue(options["deviation"]),
    )


def _smooth(pymeshlab: Any, meshes: Any, options: Options) -> None:
    meshes.apply_coord_taubin_smoothing(
        lambda_=options["shrink"], mu=-options["inflate"], stepsmoothnum=options["iterations"]
    )


def _decimate(pymeshlab: Any, meshes: Any, options: Options) -> None:
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=options["faces"],
        qualitythr=0.3,
        preservetopology=True,
        preserveboundary=True,
        preservenormal=True,
        optimalplacement=True,
        planarquadric=True,
        autoclean=False,  # it would drop faces and so open the mesh
    )


_FILTERS: Mapping[str, Callable[[Any, Any, Options], None]] = {
    "clean": _clean,
    "merge": _merge,
    "split": _split,
    "orient": _orient,
    "close": _close,
    "unite": _unite,
    "wrap": _wrap,
    "remesh": _remesh,
    "smooth": _smooth,
    "decimate": _decimate,
}
