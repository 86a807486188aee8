"""Design, verify, simulate and print stochastic porous microstructures.

The public face: what third-party stages, scripts and notebooks use is here, and in its sub-faces
`sppm_pipeline.nouns` (what passes between stages), `sppm_pipeline.numerics` (arrays in, arrays out),
`sppm_pipeline.pictures`, `sppm_pipeline.formats`, `sppm_pipeline.errors` and `sppm_pipeline.testing`. Names are loaded
when they are first used, so that the import costs next to nothing.

Run a configuration, or call its stages as functions::

    import sppm_pipeline as sppm

    run = sppm.run("cell.yaml", params={"porosity": 0.6}, seed=3)
    run["field.gaussian"], run.numbers["tune.porosity.porosity"]

    pores = sppm.sample.dart_throwing(total=66, share=0.55, seed=1)
    graph = sppm.connect.mbdst(pores, seed=1)
    cell = sppm.field.gaussian(pore_radius=0.13, tunnel_radius=0.04)(graph)
    cell.sample(64), sppm.homogenize.voxel(resolution=64)(cell).C

Write a stage::

    @dataclass(frozen=True, kw_only=True)
    class Shrink(sppm.Stage):
        '''Make a mesh smaller.'''

        name: ClassVar[str] = "mesh.shrink"
        factor: float = sppm.option(0.99, help="what lengths are multiplied by", above=0, maximum=1)

        def run(self, context: sppm.Context, mesh: sppm.SurfaceMesh) -> sppm.SurfaceMesh:
            return sppm.SurfaceMesh(self.factor * mesh.vertices, mesh.faces)
"""

from __future__ import annotations

__version__ = "0.1.0"

API = 1
"""Version of the hooks and of what a stage is; raised when a change breaks plugins.

The module of a plugin may hold ``SPPM_API_VERSION = 1``; it is then refused by a program with another number.
"""

TYPE_CHECKING = False  # importing `typing` would take longer than all else here
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

_SUBFACES = ("errors", "formats", "nouns", "numerics", "pictures", "testing")


def lazily(face: str, file: str) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """``__all__``, ``__getattr__`` and ``__dir__`` of a module that loads its names when they are first used.

    The names are those of its stub, the file beside it that type checkers read: ``from module import there as name`` on
    a line each, and ``public = _name`` for what has another name there.

    Parameters
    ----------
    face, file : str
        The module, by name and by file.
    """
    place_of: dict[str, tuple[str, str]] = {}
    with open(f"{file.rpartition('.')[0]}.pyi", encoding="utf-8") as stub:
        for words in map(str.split, stub):
            if words[:1] == ["from"] and words[1] != "sppm_pipeline":
                place_of[words[5]] = (words[1], words[3])
            elif words[1:2] == ["="]:
                place_of[words[0]] = place_of.pop(words[2])

    def load(name: str) -> Any:
        import sys
        from importlib import import_module

        if name not in place_of:
            message = f"module {face!r} has no attribute {name!r}"
            if not name.startswith("_"):
                message += _hint(name, sorted(place_of))
            raise AttributeError(message)
        module, there = place_of[name]
        found = import_module(module)
        if not hasattr(found, there):  # a module of a package
            import_module(f"{module}.{there}")
        value = getattr(found, there)
        setattr(sys.modules[face], name, value)
        return value

    return sorted(place_of), load, lambda: sorted(place_of)


def _hint(name: str, names: list[str]) -> str:
    """Hint: the face or the plugin in this repository that has a name, or a name that is nearly the same."""
    from importlib import import_module

    built_in = import_module("sppm_pipeline.built_in")
    if name in built_in.TYPES:
        module = built_in.TYPES[name]
        return f"; it is {module}.{name}, of a plugin: {built_in.install_words(module.replace('_', '-'))}"
    for other in _SUBFACES:
        if name in getattr(import_module(f"sppm_pipeline.{other}"), "__all__", ()):
            return f"; it is sppm_pipeline.{other}.{name}"
    errors = import_module("sppm_pipeline.errors")
    near = errors.near_names(name, names)
    return f"; {errors.meant(near)}" if near else ""


__all__, _load, _ = lazily(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Load a public name, a sub-face, or a family of stages of a plugin, when it is first used."""
    from importlib import import_module
    from importlib.util import find_spec

    if name in _SUBFACES:
        return import_module(f"{__name__}.{name}")
    try:
        return _load(name)
    except AttributeError:
        # modules are asked for here before they are looked for, and no family begins with a capital
        if not name.islower() or name.startswith("_") or find_spec(f"{__name__}.{name}"):
            raise
        functions = import_module(f"{__name__}.engine.api.functions")
        if name in functions.families():
            return functions.family_of(name)
        raise


def __dir__() -> list[str]:
    return sorted([*__all__, *_SUBFACES, "API", "__version__"])
