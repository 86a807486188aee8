"""The reader keeps the contract of stages, and its own promises."""

from __future__ import annotations

from pathlib import Path

import pytest
from my_plugin.pore_list import ReadPores

from sppm_pipeline import InputError, Length
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext

PORES = Path(__file__).parents[1] / "pores.csv"


class TestReadPores(StageContract):
    def stages(self):
        return [ReadPores(path=PORES, edge=Length(5.0, "mm")), ReadPores(path=PORES, edge=Length(1.0, "cm"))]


def test_centers_become_fractions_of_the_cell():
    pores = ReadPores(path=PORES, edge=Length(5.0, "mm")).run(PlainContext())
    assert pores.centers[0].tolist() == [0.2, 0.4, 0.2]
    assert pores.to_numpy()[0].tolist() == [1.0, 2.0, 1.0]


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "1,2,x", "1,2,nan", "1,2,6", "1,2,3\n1,2,3", "\0\xff"])
def test_a_wrong_file_is_refused_by_name(tmp_path, text):
    (tmp_path / "wrong.csv").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=r"wrong\.csv"):
        ReadPores(path=tmp_path / "wrong.csv", edge=Length(5.0, "mm")).run(PlainContext())
