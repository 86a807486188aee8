"""The built-in presets: recipes that users name instead of writing them down."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sppm_pipeline.hookspecs import Preset

if TYPE_CHECKING:
    from sppm_pipeline.method.fields.scalar_field import ScalarField

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


def cell(
    preset: str = "paper", *, seed: int, porosity: float | None = None, threads: int | None = None, **more: Any
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
        Parameters of the preset, such as ``total=60``, and with a porosity options of ``tune.porosity``, such as
        ``hold="pore_radius"``.

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
    """
    # late: presets are listed without the program of plans and runs
    from dataclasses import replace

    from sppm_pipeline.engine.api.functions import make_function
    from sppm_pipeline.engine.api.pipeline import Pipeline
    from sppm_pipeline.engine.api.registering import registry
    from sppm_pipeline.engine.config.configuration import stages_of
    from sppm_pipeline.engine.config.document import as_node, plain
    from sppm_pipeline.engine.config.options import options_of, plain_option
    from sppm_pipeline.engine.config.problems import did_you_mean
    from sppm_pipeline.errors import ConfigError, Position
    from sppm_pipeline.method.fields.microstructure import Microstructure
    from sppm_pipeline.nouns.length import CELL_UNIT, Cell, Length, parse_length

    known = registry().presets
    if preset not in known:
        raise ConfigError(f"there is no preset {preset!r}", hint=did_you_mean(str(preset), known))
    params = {name: more.pop(name) for name in known[preset].params if name in more}
    allowed = options_of(registry().get("tune.porosity")) if porosity is not None else {}
    if unknown := [name for name in more if name not in allowed]:
        raise ConfigError(
            f"the preset {preset!r} has no parameter {unknown[0]!r}",
            hint=did_you_mean(unknown[0], [*known[preset].params, *allowed]),
        )
    # omega and mu without a unit count in the preset's own edge, so that the size is given to what they make
    own = known[preset].params.get("edge")
    size = parse_length(params["edge"]) if isinstance(own, (int, float)) and "edge" in params else Length(1)
    if size.unit not in (None, CELL_UNIT) and not {"omega", "mu"} & params.keys():
        del params["edge"]
    else:
        size = Length(1)
    where = Position(f"sppm.cell({preset!r})", 0, 0)
    nodes = {name: as_node(plain_option(value), where) for name, value in params.items()}
    stages = plain(stages_of(known[preset], where, nodes))
    if porosity is not None:
        found = make_function("tune.porosity")(target=porosity, recipe=stages, seed=seed, threads=threads, **more)
    else:
        run = Pipeline(stages, name=preset, seed=seed).run(threads=threads, cache=False)
        found = run[run.record["stages"][-1]["id"]]
    made: ScalarField = found
    if size.unit is not None and isinstance(made, Microstructure):
        sized = Cell(size.mm(), True)
        made = replace(made, cell=sized, graph=replace(made.graph, pores=replace(made.graph.pores, cell=sized)))
    return made
