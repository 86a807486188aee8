"""What all built-in stages share."""

from pathlib import Path

import pytest

import sppm_pipeline
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.contracts import StageContract
from tests.built_in import BUILT_IN, STAGES, stage_class

REQUIRED = {
    "read.mesh": {"path": "a.stl"},
    "read.voxels": {"path": "a.npy"},
    "read.scan": {"path": "a.npy"},
    "tune.match": {"vary": ("total",), "low": (1.0,), "high": (2.0,)},
    "print.simulate": {"spread": Length(0.02), "penetration": Length(0.1), "cure_depth": Length(0.1)},
    "read.volume_mesh": {"path": "a.vtu"},
    "read.compression": {"path": "a.csv"},
    "read.primitive": {"shape": "box", "size": ()},
    "grade.formula": {"of": "porosity", "formula": "x"},
    "grade.table": {"of": "porosity", "values": ((0.0, 0.5),)},
    "grade.image": {"of": "ct", "path": "a.npy"},
    "grade.points": {"of": "ct", "path": "a.csv"},
    "grade.nodes": {"of": "ct", "path": "a.vtu"},
    "grade.distance": {"of": "depth"},
    "tune.plateau": {"target": 1.0},
    "simulate.part": {"young": 1000.0},
    "optimize.density": {"young": 1000.0},
    "warp.cylinder": {"inner_radius": Length(5.0)},
    "warp.sphere": {"inner_radius": Length(5.0)},
    "warp.hexahedra": {"path": "a.vtu"},
    "tile.hexahedra": {"path": "a.vtu"},
    "read.hexahedra": {"path": "a.vtu"},
    "sample.elimination": {"count": 3},
    "slice.mesh": {"pixel": Length(0.1)},
    "fill.combine": {"operation": "union"},
    "tune.porosity": {"target": 0.5},
    "fill.engrave": {"text": "7", "middle": (Length(0.0), Length(0.0), Length(1.0))},
    "design.sizes": {"pore": Length(0.6, "mm"), "strut": Length(0.4, "mm")},
    "tune.stiffness": {"target": 0.1},
    "tune.property": {"of": "elastic.E.1", "target": 0.1, "vary": "porous.target", "low": 0.3, "high": 0.8},
    "write.chart": {"x": "a", "y": "b"},
    "write.bars": {"columns": ("a",)},
    "write.table": {"columns": ("a",)},
}


@pytest.mark.parametrize("name", STAGES)
def test_names_files_docs_and_ports(name):
    cls = stage_class(name)
    assert cls.name == name
    stage = cls(**REQUIRED.get(name, {}))

    class Suite(StageContract):
        def stages(self):
            return [stage]

    suite = Suite()
    suite.test_has_a_name_of_family_and_word()
    suite.test_says_what_it_does()
    suite.test_is_frozen()
    suite.test_declares_its_ports()


def test_every_file_is_registered():
    package = Path(sppm_pipeline.__file__).parent
    files = {
        path.stem.replace("_", ".", 1)
        for folder in (package / "method", *(package / "features").iterdir())
        for path in (folder / "stages").glob("*.py")
        if path.stem != "__init__"
    }
    assert files == set(BUILT_IN)
