"""Curves and crushed bodies: checked, summed up, kept on disk."""

import dataclasses

import numpy as np
import pytest
from sppm_crushing.compression import CompressionCurve, CrushedBody

from sppm_pipeline.nouns.storage import load_value, save_value

CORNERS = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])
CURVE = CompressionCurve(
    [0, 0.1, 0.2], [0, 2.0, 3.0], "MPa", "simulated", "gyroid", area=400.0, height=20.0, density=0.4,
    energies={"external": [0, 0.1, 0.35]}, plates=np.zeros((3, 2)),
)  # fmt: skip
BODY = CrushedBody(
    **{field.name: getattr(CURVE, field.name) for field in dataclasses.fields(CURVE)},
    grid=(1, 1, 1), spacing=20.0, voxels=[[0, 0, 0]], phases=[1], elements=[range(8)], frame_strains=[0, 0.2],
    frame_nodes=20.0 * np.array([CORNERS, CORNERS * (1, 1, 0.8)]), frame_alpha=[[0], [0.1]],
)  # fmt: skip


@pytest.mark.parametrize("made", [CURVE, BODY], ids=["curve", "body"])
def test_what_is_kept_on_disk_comes_back(made, tmp_path):
    made.check()
    files = {file.name: file for file in save_value(made, tmp_path)}
    again = load_value(tmp_path, files)
    assert type(again) is type(made)
    assert again.digest() == made.digest()
    assert again.summary() == made.summary()
    assert len(repr(made)) < 500


def test_force_and_displacement():
    assert CURVE.force.tolist() == [0, 800, 1200]
    assert dataclasses.replace(CURVE, unit="GPa").force.tolist() == [0, 8e5, 1.2e6]
    assert dataclasses.replace(CURVE, unit="relative").force is None
    assert CURVE.displacement.tolist() == [0, 2, 4]
    assert CURVE.summary()["energies"] == {"external": 0.35}
    assert BODY.summary()["plastic_strain_max"] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"stress": [0, 1]}, "two or more points"),
        ({"strain": [0], "stress": [0], "plates": None, "energies": {}}, "two or more points"),
        ({"stress": [0, np.nan, 1]}, "finite"),
        ({"unit": "psi"}, "'psi'"),
        ({"origin": "guessed"}, "'guessed'"),
        ({"area": 0.0}, "area"),
        ({"density": -1.0}, "density"),
        ({"plates": np.zeros((2, 2))}, "two plates"),
        ({"energies": {"external": [0, 1]}}, "'external'"),
        ({"axis": "w"}, "'w'"),
        ({"phases": [0]}, "void"),
        ({"voxels": [[0, 0, 1]]}, "outside"),
        ({"elements": [range(1, 9)]}, "does not exist"),
        ({"frame_strains": [0.2, 0.2]}, "order"),
        ({"frame_strains": [0.2]}, "frame_nodes"),
        ({"frame_alpha": [[0], [np.inf]]}, "finite"),
    ],
)
def test_contradictions_are_named(changes, said):
    with pytest.raises(ValueError, match=said):
        dataclasses.replace(BODY, **changes).check()
