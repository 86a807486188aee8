"""Files of test machines: what is found out and told, what is refused, and what is hostile."""

import contextlib
import math
import time

import numpy as np
import pytest
from sppm_crushing.machine_csv import UNITS, read_readings

from sppm_pipeline.errors import InputError

FORCE = np.array([0.0, 12.5, 1250.25, 980.0, 1500.0])
WAY = np.array([0.0, 0.05, 0.5, 1.25, 2.0])


def lines(head, row="{f},{d}", decimal=".", force=FORCE, way=WAY):
    rows = [row.format(f=f"{f:.4f}", d=f"{d:.4f}", i=i) for i, (f, d) in enumerate(zip(force, way, strict=True))]
    return head + "".join(f"{text.replace('.', decimal) if decimal != '.' else text}\n" for text in rows)


GOOD = {
    "plain": lines("Force (N),Displacement (mm)\n"),
    "units below": lines("Force,Displacement\nN,mm\n"),
    "bluehill": lines(
        '"Specimen_RawData_1"\n\n"Time","Extension","Load"\n"(s)","(mm)","(N)"\n', '"{i}","{d}","{f}"'
    ),
    "more than is needed": lines(
        "Time (s),Compressive extension (mm),Compressive load (N),Compressive strain (%),Compressive stress (MPa)\n",
        "{i},{d},{f},0.1,2.5",
    ),
    "german": lines(
        "Prüfprotokoll;Nr. 3\nDatum;1.2.2026\n\nPrüfzeit;Standardweg;Standardkraft\ns;mm;N\n", "{i}.5;{d};{f}", ","
    ).encode("cp1252"),
    "kilonewtons": lines("Kraft in kN;Weg in mm\n", "{f};{d}", ",", FORCE / 1000 + 0),
    "chinese": lines("序号\t试验力(N)\t位移(mm)\n", "{i}\t{f}\t{d}").encode("gb18030"),
    "utf-16": lines("Load [N];Stroke [mm]\n", "{f};{d}").encode("utf-16"),
    "utf-16 without a mark": lines("Load [N];Stroke [mm]\n", "{f};{d}").encode("utf-16-le"),
    "bom": b"\xef\xbb\xbf" + lines("Load/N;Stroke/mm\n", "{f};{d}").encode(),
    "blanks": lines("Force (N)   Displacement (mm)\n", "  {f}    {d}  "),
    "underscores and case": lines("displacement_mm\tFORCE_N\n", "{d}\t{f}"),
    "status and footer": lines("Force (N),Displacement (mm),State\n", "{f},{d},run") + "\nMaximum,1500 N\nend\n",
    "thousands": lines(
        "Force (N);Displacement (mm)\n", "{f};{d}").replace("1250.2500", "1,250.2500").replace("1500.0", "1,500.0"),
    "thousands, german": lines(
        "Kraft (N);Weg (mm)\n", "{f};{d}", ",").replace("1250,2500", "1.250,2500").replace("1500,0", "1.500,0"),
    "carriage returns": lines("Force (N),Displacement (mm)\n").replace("\n", "\r"),
    "exponents": "Load (N),Travel (mm)\n0,0\n1.25E+1,5e-2\n1.25025e3,.5\n+980.,1.25\n1500,2\n",
}  # fmt: skip


@pytest.mark.parametrize("name", GOOD)
def test_files_as_machines_write_them(name):
    text = GOOD[name]
    factor = 1.0 if name != "kilonewtons" else 1e3
    read = read_readings(text if isinstance(text, bytes) else text.encode(), "test.csv")
    assert (read.load_kind, read.way_kind) == ("force", "displacement")
    assert read.load == pytest.approx(FORCE, abs=0.06 if factor > 1 else 1e-9)
    assert read.way == pytest.approx(WAY, abs=1e-9)
    assert "from column" in read.notes[1]


def test_stress_and_strain_are_read_where_there_is_no_force():
    read = read_readings(b"Stauchung (%);Druckspannung (kPa)\n0;0\n10;200\n50;2200\n", "a.csv")
    assert (read.load_kind, read.way_kind) == ("stress", "strain")
    assert read.load.tolist() == [0, 0.2, 2.2]
    assert read.way.tolist() == pytest.approx([0, 0.1, 0.5])


def test_columns_and_units_can_be_said():
    text = b"0,5,0\n1,6,1\n2,7,4\n"
    read = read_readings(text, "a.csv", columns=("3", "1"), units=("kN", "in"))
    assert read.load.tolist() == [0, 1000, 4000]
    assert read.way.tolist() == [0, 25.4, 50.8]
    named = b"Channel 1 (N);Channel 2 (mm)\n0;0\n1;2\n2;4\n"
    assert read_readings(named, "a.csv", columns=("Channel 2 (mm)", "channel 1"), units=("N", "mm")).load[2] == 4
    stress = read_readings(named, "a.csv", columns=("1", "2"), units=("psi", "%"))
    assert (stress.load_kind, stress.way_kind) == ("stress", "strain")


def test_units_are_exact():
    """The international inch and pound and standard gravity, from which all others follow."""
    assert UNITS["displacement"]["in"] == 25.4
    assert UNITS["force"]["lbf"] == pytest.approx(0.45359237 * 9.80665, rel=1e-15)
    assert UNITS["force"]["kgf"] == 9.80665
    assert UNITS["force"]["kip"] == pytest.approx(1000 * UNITS["force"]["lbf"], rel=1e-15)
    assert UNITS["stress"]["psi"] == pytest.approx(0.006894757293168361, rel=1e-15)
    assert UNITS["stress"]["ksi"] == pytest.approx(6.894757293168361, rel=1e-15)
    read = read_readings(b"Load (lbf),Extension (in)\n0,0\n50,.5\n100,1\n", "a.csv")
    assert read.load[2] == pytest.approx(444.82216152605)
    assert read.way[2] == 25.4


TABLE = "Force (N);Displacement (mm)\n"
HOSTILE = {
    "empty": (b"", "is empty"),
    "blank": (b" \n\n\t\n", "is empty"),
    "text": (b"Dear colleague,\nthe test went well.\n" * 50, "holds no table"),
    "noise": (bytes(range(256)) * 200, "holds no table|fewer than three|no column"),
    "zeros": (bytes(10000), "holds no table|is empty"),
    "one column": (b"Force (N)\n1\n2\n3\n4\n", "holds no table"),
    "two readings": (f"{TABLE}0;0\n1;1\n".encode(), "fewer than three readings"),
    "not a number": (f"{TABLE}0;0\n1;1\n2;2\nnan;3\n4;4\n".encode(), "line 5 has 'nan' for a number, and the table"),
    "a gap": (f"{TABLE}0;0\n1;1\n2;2\n;3\n4;4\n".encode(), "line 5 has '' for a number"),
    "infinite": (f"{TABLE}0;0\n1;1\n2;2\n1e999;3\n".encode(), "reading 4 .*'1e999', which is not finite"),
    "word": (f"{TABLE}0;0\n1;1\n2;2\nslip;3\n4;4\n".encode(), "line 5 has 'slip'"),
    "short row": (f"{TABLE}0;0\n1;1\n2;2\n3\n4;4\n".encode(), "line 5 has ''"),
    "two tables": (f"{TABLE}0;0\n1;1\n2;2\n\n{TABLE}0;0\n1;1\n2;2\n".encode(), "line 6 has 'Force .N.'.* line 7"),
    "no headings": (b"0;0\n1;1\n2;2\n", "no column is called force or stress"),
    "strange headings": (b"A;B\nN;mm\n0;0\n1;1\n2;2\n", "name them: columns: .*there are 'A', 'B'"),
    "two forces": (b"Force (N);Load (N);Weg (mm)\n0;0;0\n1;1;1\n2;2;2\n", "'Force .N.', 'Load .N.' could all be"),
    "no unit": (b"Force;Weg (mm)\n0;0\n1;1\n2;2\n", "no unit is given for column 'Force'"),
    "strange unit": (b"Force (stone);Weg (mm)\n0;0\n1;1\n2;2\n", "'stone', which is none of a force"),
    "milli or mega": (b"Force (mn);Weg (mm)\n0;0\n1;1\n2;2\n", "'mn', which is none of a force"),
    "commas everywhere": (b"Force (N),Weg (mm)\n0,5,0,1\n1,5,0,2\n2,5,0,3\n", "4 numbers stand below 2 headings"),
    "thousands or decimals": (f"{TABLE}1,250;1,500\n2,500;1,750\n3,125;2,250\n".encode(), "may be a number of thous"),
    "marks change": (f"{TABLE}1,250.5;1\n2.500,5;2\n3;3\n".encode(), "change their meaning"),
    "marks change in turn": (f"{TABLE}0,5;1\n2.5;2\n3;3\n".encode(), "change their meaning"),
    "endless head": (b"text\n" * 3000 + f"{TABLE}0;0\n1;1\n2;2\n".encode(), "holds no table"),
    "endless line": (b"Force (N);Weg (mm)\n0;0\n1;1\n2;2\n" + b"7" * 300_000 + b";3\n", "can't be read behind line 4"),
    "open quote": (b'Force (N);Weg (mm)\n0;0\n1;1\n2;2\n"3;3\n4;4\n', "quotation mark in line 5 is not closed"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_with_a_reason(name):
    data, said = HOSTILE[name]
    with pytest.raises(InputError, match=f"(?s){said}") as caught:
        read_readings(data, "test.csv")
    assert caught.value.message.startswith("test.csv")


def test_a_decimal_mark_that_is_said_settles_it():
    data = f"{TABLE}1,250;1,500\n2,500;1,750\n3,125;2,250\n".encode()
    assert read_readings(data, "a.csv", decimal="comma").load.tolist() == [1.25, 2.5, 3.125]
    assert read_readings(data, "a.csv", decimal="point").load.tolist() == [1250, 2500, 3125]


def test_many_readings():
    n = 100_000  # the time grows with the number of lines; a million took 5 s
    data = (TABLE + "\n".join(f"{i};{i / 1000}" for i in range(n))).encode()
    read = read_readings(data, "long.csv")
    assert len(read.load) == n
    assert read.way[-1] == pytest.approx(n / 1000 - 0.001)
    assert not math.isnan(read.load.sum())


@pytest.mark.parametrize("mark", ["*****", "####", "OVL", "+inf", "Overflow"])
@pytest.mark.parametrize("rows", [0, 2])
def test_a_reading_beyond_the_range_of_the_machine_is_named(mark, rows):
    table = "Force (N),Displacement (mm)\n0,0\n1,1\n2,2\n3,3\n" + f"{mark},4\n" + "4,5\n" * rows
    with pytest.raises(InputError, match=r"line 6 has '.*' in column 'Force \(N\)': the reading was too large"):
        read_readings(table.encode(), "a.csv")


@pytest.mark.parametrize("text", ["(a ", "a (b ", "1.0, (2.0, ", "a in ", "( "])
def test_hostile_lines_take_linear_time(text):
    table = "Force (N)   Displacement (mm) " + text * 30_000 + "\n" + "1   2\n" * 5
    start = time.process_time()
    for delimited in (table, table.replace("   ", ";")):
        with contextlib.suppress(InputError):
            read_readings(delimited.encode(), "a.csv")
    assert time.process_time() - start < 3


def test_a_kilopond_is_a_kilogram_force_to_the_last_digit():
    """Standard gravity is 9.80665 m/s2 by definition, not the 9.81 of schoolbooks."""
    assert UNITS["force"]["kp"] == UNITS["force"]["kgf"] == 1000 * UNITS["force"]["gf"] == 9.80665
