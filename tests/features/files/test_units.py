"""Units of length that files state."""

from sppm_pipeline.features.files.formats.three_mf_model import UNITS_IN_MM


def test_units_of_3mf_in_millimeters():
    """An inch is 25.4 mm exactly (1959), a foot twelve of them; the names are those of the 3MF core specification."""
    assert UNITS_IN_MM == {
        "micron": 1e-3,
        "millimeter": 1,
        "centimeter": 10,
        "inch": 25.4,
        "foot": 304.8,
        "meter": 1e3,
    }
