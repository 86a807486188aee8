"""Tables: columns, order, files, digests."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.nouns.storage import load_value, save_value
from sppm_pipeline.nouns.table import RunFile, Table

COLUMNS = {"name": ["b", "a", None, "c"], "value": [2.0, None, 1, 2.0], "flag": [True, False, True, "x"]}
FILES = {"cell.png": [RunFile("/there/cell.png", "ab"), None, None, RunFile("/here/cell.png", "cd")]}


def test_columns_as_numbers_and_texts():
    table = Table(COLUMNS)
    assert table.column("name") == ("b", "a", None, "c")
    assert table.texts("value") == ["2.0", "", "1", "2.0"]
    np.testing.assert_array_equal(table.numbers("value"), [2, np.nan, 1, 2])
    np.testing.assert_array_equal(table.numbers("flag"), [1, 0, 1, np.nan])
    with pytest.raises(ConfigError, match="no column 'valeu'") as caught:
        table.numbers("valeu")
    assert "value" in caught.value.hint


def test_order_keeps_ties_and_puts_nothing_last():
    table = Table(COLUMNS)
    assert table.order("value") == [2, 0, 3, 1]
    assert table.order("value", descending=True) == [0, 3, 2, 1]
    assert table.order("name") == [0, 1, 2, 3]


def test_files_count_in_check_digest_and_storage(tmp_path):
    table = Table(COLUMNS, FILES)
    table.check()
    with pytest.raises(ValueError, match="different lengths"):
        Table(COLUMNS, {"cell.png": [None]}).check()
    other = Table(COLUMNS, {"cell.png": [RunFile("/there/cell.png", "00"), *FILES["cell.png"][1:]]})
    assert len({Table(COLUMNS).digest(), table.digest(), other.digest()}) == 3
    again = load_value(tmp_path, {file.name: file for file in save_value(table, tmp_path)})
    assert again.files == table.files
    assert isinstance(again.files["cell.png"][0], RunFile)
    assert again.digest() == table.digest()


def sweep():
    stiffness = {f"e.C.{i}.{j}": (i + j / 10, None) for i in range(1, 7) for j in range(1, 7)}
    columns = {"run": ("0000", "0001"), "porosity": (0.5, 0.6), "seed": (3, 4), "status": ("done", "failed")}
    columns |= {"error": (None, "no"), **stiffness, "e.E.1": (1.0, 2.0), "e.E.3": (1.0, 2.0), "e.n": (1, 2)}
    return Table(columns, units=dict.fromkeys(stiffness, "MPa"))


def test_a_frame_of_pandas_has_the_columns_as_they_are():
    pytest.importorskip("pandas")
    frame = sweep().to_pandas()
    assert list(frame.columns) == list(sweep().columns)
    assert frame["seed"].dtype.kind == "i"
    assert frame["porosity"].tolist() == [0.5, 0.6]
    assert frame["e.C.1.2"].isna().tolist() == [False, True]
    assert frame.attrs["units"]["e.C.1.1"] == "MPa"


def test_a_dataset_of_xarray_has_arrays_for_what_was_counted():
    pytest.importorskip("xarray")
    found = sweep().to_xarray()
    assert set(found.coords) == {"run", "porosity", "seed"}
    assert found["seed"].dtype == np.int64
    assert found["e.C"].shape == (2, 6, 6)
    assert found["e.C"].values[0, 2, 4] == pytest.approx(3.5)
    assert np.isnan(found["e.C"].values[1]).all()
    assert found["e.C"].attrs == {"units": "MPa"}
    # of an array that lacks entries each stands for itself
    assert found["e.E.3"].values.tolist() == [1, 2]
    assert found["error"].values.tolist() == ["", "no"]


def test_units_are_no_part_of_the_value():
    assert sweep().digest() == Table(sweep().columns).digest()
