"""Material cards: the order of constants that other programs expect."""

import numpy as np
import pytest

from sppm_pipeline.features.stiffness.stages.write_stiffness import abaqus_card, abaqus_constants

# the 21 places of Abaqus' anisotropic card, written out: Dijkl with 11, 22, 33, 12, 13, 23
PLACES = "1111 1122 2222 1133 2233 3333 1112 2212 3312 1212 1113 2213 3313 1213 1313 1123 2223 3323 1223 1323 2323"
OURS = {"11": 0, "22": 1, "33": 2, "23": 3, "13": 4, "12": 5}


def numbered():
    upper = np.triu(np.arange(1, 37, dtype=float).reshape(6, 6))
    return upper + np.triu(upper, 1).T


def test_each_constant_is_in_its_place():
    matrix = numbered()
    expected = [matrix[OURS[name[:2]], OURS[name[2:]]] for name in PLACES.split()]
    assert abaqus_constants(matrix) == expected


def test_the_card():
    lines = abaqus_card("FOAM-1", numbered(), ["a comment"]).splitlines()
    assert lines[:3] == ["** a comment", "*MATERIAL, NAME=FOAM-1", "*ELASTIC, TYPE=ANISO"]
    rows = [[float(word) for word in line.split(",")] for line in lines[3:]]
    assert [len(row) for row in rows] == [8, 8, 5]
    assert [value for row in rows for value in row] == abaqus_constants(numbered())


@pytest.mark.parametrize("name", ["", "1a", "a b", "a,b", "ä", "a\n*STEP"])
def test_names_that_would_break_the_card(name):
    with pytest.raises(ValueError):
        abaqus_card(name, numbered(), [])
