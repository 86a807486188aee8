"""The built-in presets: recipes that users name instead of writing them down."""

from __future__ import annotations

from sppm_pipeline.hookspecs import Preset

_PORES = {"total": 95, "share": 0.5}
_THROWN = [
    {"stage": "sample.mirrored_faces", "edge": "${edge}", "total": "${total}", "share": "${share}"},
]
_JOINED = {"stage": "connect.mbdst", "degree": "${degree}", "mode": "greedy"}

PRESETS = {
    "paper": Preset(
        "the paper's cell: thrown pores, tunnels of degree 3 to 5, omega = mu = 30 at level 0.25 in a cell of edge 2",
        [
            *_THROWN,
            {"stage": "sample.dart_throwing", "total": "${total}"},
            _JOINED,
            {"stage": "field.gaussian", "omega": "${omega}", "mu": "${mu}", "level": "${level}"},
        ],
        {**_PORES, "edge": 2, "degree": [3, 5], "omega": 30, "mu": 30, "level": 0.25},
    ),
    "stiff": Preset(
        "stiff, isotropic and open: walls between hyperuniform pores, pierced by the fewest tunnels",
        [
            *_THROWN,
            {"stage": "sample.hyperuniform", "total": "${total}", "stealth": "${stealth}"},
            {"stage": "connect.mst"},
            {"stage": "field.walls", "tunnel_radius": "${tunnel_radius}", "rounding": "${rounding}"},
        ],
        {**_PORES, "edge": None, "stealth": None, "tunnel_radius": None, "rounding": None},
    ),
}
"""Pores lie on the faces, too, so that all of them serve single cells, tile sets and scattered cells alike."""
