"""Trusses of cubic symmetry from a graph in one of the 48 tetrahedra that mirror planes cut the cube into.

The tetrahedron's corners are the cube's center ``c``, the center ``f`` of a face, the middle ``e`` of an edge of that
face, and an end ``v`` of that edge. A node lies at a corner, on an edge, on a face or inside, 15 kinds in all; its name
is made of the letters of the corners that it lies between: ``c``, ``cf``, ``cfe``, ``cfev``. Source: Panetta et al.
2015, "Elastic textures for additive fabrication", section 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import ConfigError, DesignError
from sppm_structures.graphs import StrutGraph, strut_graph

CORNERS = {"c": (0.5, 0.5, 0.5), "f": (0.5, 0.5, 0.0), "e": (0.5, 0.0, 0.0), "v": (0.0, 0.0, 0.0)}

KINDS = tuple("".join(letters) for n in range(1, 5) for letters in combinations("cfev", n))
"""Names of the 15 kinds of nodes."""


class Texture(NamedTuple):
    """A truss: `edges` are pairs of nodes.

    By name of a node: `weights` are barycentric, one for each letter, equal ones if it is not named; `radii` are over
    the mean, 1 if it is not named.
    """

    edges: tuple[tuple[str, str], ...]
    weights: Mapping[str, tuple[float, ...]]
    radii: Mapping[str, float]


def read_pattern(text: str) -> tuple[tuple[str, str], ...]:
    """Read edges such as ``"c-cv cv-ev"``; `ConfigError` for equal kinds of nodes, or an edge that comes twice."""
    edges = []
    for word in text.replace(",", " ").split():
        ends = tuple("".join(sorted(name, key="cfev".find)) for name in word.split("-"))
        if len(ends) != 2 or not set(ends) <= set(KINDS) or ends[0] == ends[1]:
            raise ConfigError(
                f"{word!r} is no edge of a texture",
                hint=f"write two nodes with a hyphen, such as c-fv; nodes are {', '.join(KINDS)}",
            )
        if ends in edges or ends[::-1] in edges:
            raise ConfigError(f"the edge {word!r} stands in the pattern twice")
        edges.append((ends[0], ends[1]))
    if not edges:
        raise ConfigError("a texture needs at least one edge", hint='write a pattern such as "c-v v-e"')
    return tuple(edges)


def read_weights(text: str, what: str, nodes: set[str], single: bool) -> dict[str, tuple[float, ...]]:
    """Read values of nodes such as ``"cf=1:2 fev=1:1:3"``, or a single one for each if `single`.

    `ConfigError` if a node is not in the pattern, or the values are not as many positive numbers as they should be.
    """
    found: dict[str, tuple[float, ...]] = {}
    for word in text.replace(",", " ").split():
        name, _, numbers = word.partition("=")
        node = "".join(sorted(name, key="cfev".find))
        if node not in nodes or node in found:
            raise ConfigError(
                f"{what}: {name!r} is no node of the pattern, or named twice; it has {', '.join(sorted(nodes))}"
            )
        try:
            values = tuple(float(number) for number in numbers.split(":"))
        except ValueError:
            values = ()
        wanted = 1 if single else len(node)
        if len(values) != wanted or not all(0 < value < 1e3 for value in values):
            raise ConfigError(
                f"{what}: {word!r} should give {wanted} positive number(s)",
                hint="for example cf=1.5" if single else f"for example {node}={':'.join('1' for _ in node)}",
            )
        found[node] = values if single else tuple(values[name.index(letter)] for letter in node)
    return found


def texture_graph(texture: Texture) -> StrutGraph:
    """The struts of one cell: those of the tetrahedron, mirrored by the 48 symmetries of the cube.

    `DesignError` if the struts of neighboring cells are not all connected.
    """
    starts, ends, radii = [], [], []
    for a, b in texture.edges:
        for mirrored in _SYMMETRIES:
            starts.append(0.5 + mirrored @ (_place(texture, a) - 0.5))
            ends.append(0.5 + mirrored @ (_place(texture, b) - 0.5))
            radii.append((texture.radii.get(a, 1.0), texture.radii.get(b, 1.0)))
    sizes = np.array(radii)
    graph = strut_graph(np.array(starts), np.array(ends), sizes[:, 0], sizes[:, 1])
    if not any("c" not in node for edge in texture.edges for node in edge) or _parts(graph) > 1:
        raise DesignError(
            "the struts of this pattern are not all connected",
            hint="join its nodes by a path, and let one of them lie on the face of the cube: a name without c",
        )
    return graph


def _place(texture: Texture, node: str) -> NDArray[np.float64]:
    weights = np.array(texture.weights.get(node, (1.0,) * len(node)))
    place: NDArray[np.float64] = weights @ np.array([CORNERS[letter] for letter in node]) / weights.sum()
    return place


_SYMMETRIES = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]


def _parts(graph: StrutGraph) -> int:
    """Components of the graph on the torus."""
    places: dict[tuple[int, ...], int] = {}

    def number(point: NDArray[np.float64]) -> int:
        key = tuple(int(v) for v in np.round(point * 1e6) % 1_000_000)
        return places.setdefault(key, len(places))

    pairs = [(number(a), number(b)) for a, b in zip(graph.starts, graph.ends, strict=True)]
    part = list(range(len(places)))
    for _ in range(len(places)):
        changed = False
        for a, b in pairs:
            low = min(part[a], part[b])
            changed = changed or part[a] != part[b]
            part[a] = part[b] = low
        if not changed:
            break
    return len(set(part))


def _texture(pattern: str, weights: str = "", radii: str = "") -> Texture:
    edges = read_pattern(pattern)
    nodes = {node for edge in edges for node in edge}
    sizes = read_weights(radii, "radii", nodes, True)
    return Texture(edges, read_weights(weights, "weights", nodes, False), {node: r for node, (r,) in sizes.items()})


TEXTURES: dict[str, Texture] = {
    "braced_frame": _texture("c-v e-v", radii="e=1.75"),
    "star_faces": _texture("c-ev f-ev", weights="ev=1:1.8"),
    "dented_faces": _texture("cf-ev cf-f", weights="cf=2.35:1"),
}
"""Nearly isotropic ones: parameters were searched for Zener's ratio 1 at a relative density of 0.3."""
