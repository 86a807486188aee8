"""The table of measures, published energies that can't be, and what a sweep sees."""

import numpy as np
import pytest
from sppm_crushing.compression import CompressionCurve
from sppm_crushing.numerics.compression import measures
from sppm_crushing.stages.measure_compression import NUMBERS, MeasureCompression

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.testing.plain_context import PlainContext

STRAIN = np.array([0, 0.03, 0.05, 0.1, 0.25, 0.5, 0.6])
STRESS = np.array([0, 3.0, 2.5, 2.0, 2.0, 2.2, 4.0])
CURVE = CompressionCurve(STRAIN, STRESS, "MPa", "measured", "foam", area=2025.0, height=45.0, density=0.4)


def test_the_table_holds_every_measure_with_its_definition():
    context = PlainContext()
    table = MeasureCompression(energy_to=0.25).run(context, CURVE)
    rows = dict(zip(table.column("measure"), table.column("value"), strict=True))
    assert rows["W to 25 %"] == context.reported["energy_to_strain"] == pytest.approx(0.5125)
    assert all(table.column("definition"))
    assert set(NUMBERS) == {m.name for m in measures(STRAIN, STRESS)}
    assert set(NUMBERS) <= set(context.reported)
    assert context.reported["without"] == {"elastic_gradient": "no such loop of unloading"}
    assert context.reported["elastic_gradient"] is None


@pytest.mark.parametrize(
    ("published", "flagged"),
    [
        ((1.7765, 2.6396, 6.065), False),  # TPMS-P
        ((1.4936, 5.2674, 16.11), True),  # TPMS-L
        ((1.6477, 2.3844, 8.357), True),  # Kelvin
        ((1.5488, 3.9342, 12.39), True),  # Octet
        ((2.1695, 2.8259, 8.753), False),  # ET-1
        ((1.1789, 6.7259, 6.236), False),  # ET-2
        ((0.5452, 20.2926, 20.93), False),  # SPPM-1
        ((0.4433, 20.3177, 16.73), False),  # SPPM-2
    ],
)
def test_energies_of_the_paper_that_exceed_force_times_way_are_flagged(published, flagged):
    context = PlainContext()
    MeasureCompression(published=published).run(context, CURVE)
    assert (context.reported["published"]["ratio"] > 1) == flagged
    assert ("impossible" in str(context.warnings)) == flagged


def test_what_can_not_be_measured_is_said():
    with pytest.raises(ConfigError, match=r"`plateau` goes from 0\.4 to 0\.2"):
        MeasureCompression(plateau=(0.4, 0.2)).check_options()
    tension = CompressionCurve(STRAIN, -STRESS, "MPa", "measured", "foam")
    with pytest.raises(DesignError, match=r"foam can't be measured: .* negative"):
        MeasureCompression().run(PlainContext(), tension)
    with pytest.raises(ConfigError, match="needs the area"):
        MeasureCompression(published=(1.0, 1.0, 1.0)).run(
            PlainContext(), CompressionCurve(STRAIN, STRESS, "MPa", "measured")
        )
