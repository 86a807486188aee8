"""The built-in presets: recipes that users name instead of writing them down."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from sppm_pipeline.hookspecs import Preset

if TYPE_CHECKING:
    from typing import Unpack

    from sppm_pipeline.engine.api.stages import CellOptions
    from sppm_pipeline.method.fields.scalar_field import ScalarField
    from sppm_pipeline.nouns.length import Length

_PORES = {"total": 95, "share": 0.5}
_THROWN = [{"stage": "sample.mirrored_faces", "edge": "${edge}", "total": "${total}", "share": "${share}"}]
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


_SIZES = {"pore_radius": "omega", "tunnel_radius": "mu"}
"""Options that state the same size in two ways."""


def cell(
    preset: str = "paper",
    *,
    seed: int,
    porosity: float | None = None,
    threads: int | None = None,
    **more: Unpack[CellOptions],
) -> ScalarField:
    """A cell of a preset in one line, of a given porosity if one is given.

    Parameters
    ----------
    preset : str
        A name that ``sppm stages`` lists: "paper", "stiff", "open", or one of a plugin.
    seed : int
    porosity : float, optional
        Share of the void, which ``tune.porosity`` reaches; that of the preset's own parameters if omitted.
    threads : int, optional
        As many as there are processors if omitted; no result depends on it.
    **more
        Parameters of the preset, such as ``total=60``, and options of its stages, such as ``pore_radius=0.12`` of
        ``field.gaussian``, which stands instead of the preset's omega. With a porosity options of ``tune.porosity``,
        too, such as ``hold="pore_radius"``, which keeps that radius.

    Raises
    ------
    ConfigError
        If there is no such preset, parameter or option, or a value is not allowed.

    Examples
    --------
    >>> import sppm_pipeline as sppm
    >>> cell = sppm.cell("stiff", edge="4 mm", seed=1)
    >>> cell.edge_mm, cell.centers_mm.shape[1]
    (4.0, 3)
    >>> wide = sppm.cell("paper", seed=1, edge="4 mm", tunnel_radius="0.3 mm")
    """
    # late: presets are listed without the program of plans and runs
    from sppm_pipeline.engine.api.functions import make_function
    from sppm_pipeline.engine.api.pipeline import Pipeline
    from sppm_pipeline.engine.api.registering import registry
    from sppm_pipeline.engine.config.configuration import stages_of
    from sppm_pipeline.engine.config.document import as_node, plain
    from sppm_pipeline.engine.config.options import options_of, plain_option
    from sppm_pipeline.errors import ConfigError, Position, did_you_mean
    from sppm_pipeline.method.fields.microstructure import Microstructure
    from sppm_pipeline.nouns.length import CELL_UNIT, Cell

    known = registry().presets
    if preset not in known:
        raise ConfigError(f"there is no preset {preset!r}", hint=did_you_mean(str(preset), known))
    own = known[preset].params
    given: dict[str, Any] = {name: plain_option(value) for name, value in more.items()}
    params = {name: given.pop(name) for name in own if name in given}
    params |= {size: None for radius, size in _SIZES.items() if radius in given and size in own.keys() - params.keys()}
    # omega and mu without a unit count in the preset's own edge, so that the size is given to what they make
    edge = _length(params.get("edge")) if isinstance(own.get("edge"), (int, float)) else None
    sized = None
    if edge and edge.unit not in (None, CELL_UNIT) and not any(params.get(size) for size in _SIZES.values()):
        sized = Cell(edge.mm(), True)
        del params["edge"]
    if "edge" not in params:  # which would make the preset's own edge the unit
        radii = {name: length for name in _SIZES if (length := _length(given.get(name)))}
        size = sized.edge if sized else None
        given |= {name: f"{length.in_cells(size)!r} {CELL_UNIT}" for name, length in radii.items()}
    where = Position(f"sppm.cell({preset!r})", 0, 0)
    stages = plain(stages_of(known[preset], where, {name: as_node(value, where) for name, value in params.items()}))
    known_options = [options_of(registry().get(entry["stage"])).keys() for entry in stages]
    for options, entry in zip(known_options, stages, strict=True):
        entry.update({name: value for name, value in given.items() if name in options})
    tuning = options_of(registry().get("tune.porosity")).keys()
    of_tuning = {name: value for name, value in given.items() if not any(name in options for options in known_options)}
    for name in of_tuning:
        if name not in tuning or porosity is None:
            hint = did_you_mean(name, {*own, "porosity"}.union(*known_options))
            if name in tuning:
                hint = "it is one of tune.porosity, which reaches a `porosity`: give one, too"
            raise ConfigError(f"the preset {preset!r} has no parameter or option {name!r}", hint=hint)
    if porosity is not None:
        tune = make_function("tune.porosity")
        found = tune(target=porosity, recipe=stages, seed=seed, threads=threads, **of_tuning)
    else:
        run = Pipeline(stages, name=preset, seed=seed).run(threads=threads, cache=False)
        found = run[run.record["stages"][-1]["id"]]
    made: ScalarField = found
    if sized is not None and isinstance(made, Microstructure):
        made = replace(made, cell=sized, graph=replace(made.graph, pores=replace(made.graph.pores, cell=sized)))
    return made


def _length(value: Any) -> Length | None:
    """A length; of what is none the stage says so, with its name."""
    from sppm_pipeline.nouns.length import parse_length

    try:
        return parse_length(value)
    except ValueError:
        return None
