"""Reports: what follows from numbers that are declared once."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from sppm_crushing import CompressionCurve, CrushedBody

from sppm_pipeline.engine.strict_json import jsonable
from sppm_pipeline.features.flow.acoustics import AcousticReport
from sppm_pipeline.features.flow.permeability import ConductivityReport, PermeabilityReport
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.nouns.report import TEXT, Box, Headline, Number, Report, number, reports


@dataclass(frozen=True, eq=False)
class Mixture(Report):
    """Numbers of all kinds."""

    headline = ("parts.2", "kind", "moduli")

    parts: tuple[float, ...] = field(metadata=number("#2", label="part", unit="{unit}", error="bars", box="parts"))

    @reports("moduli.low", Number("moduli.high.#2"))
    def _moduli(self):
        return min(self.parts), np.array(self.parts)

    unit: str = field(metadata=TEXT)
    bars: tuple[float, ...] | None = field(default=None, metadata=number("#2", optional=True))
    hidden: int = 3

    @property
    @reports(label="which")
    def kind(self):
        """Where it is None it is stated."""
        return


@dataclass(frozen=True, eq=False)
class Finer(Mixture):
    """Entries of the base come first."""

    more: float = field(default=1.0, metadata=number("inner.more"))


def test_a_summary_has_the_order_of_the_class():
    made = Finer((1.0, 2.0), "MPa")
    assert list(made.summary()) == ["parts", "moduli", "unit", "kind", "inner"]
    assert jsonable(made.summary()) == {
        "parts": [1.0, 2.0], "moduli": {"low": 1.0, "high": [1.0, 2.0]}, "unit": "MPa", "kind": None,
        "inner": {"more": 1.0},
    }  # fmt: skip
    assert Finer.reported == (*Mixture.reported, "inner.more")
    assert Mixture.reported == ("parts.#2", "moduli.low", "moduli.high.#2", "bars.#2", "kind")
    assert replace(made, bars=(0.1, 0.2)).summary()["bars"] == [0.1, 0.2]


def test_attributes_that_are_not_there_are_answered_by_those_that_are():
    made = Finer((1.0, 2.0), "MPa")
    with pytest.raises(AttributeError, match="a Finer has no 'part'; did you mean 'parts'"):
        _ = made.part
    with pytest.raises(AttributeError, match=r"no 'zzz'; known: .*hidden.*more"):
        _ = made.zzz
    assert not hasattr(made, "_private")


def test_headlines_and_boxes_have_labels_units_and_error_bars():
    assert Mixture.headlines() == (
        Headline("parts.2", "part2", "{unit}", "bars.2"), Headline("kind", "which"), Headline("moduli", "moduli"),
    )  # fmt: skip
    recorded = jsonable(Mixture((1.0, 2.0), "MPa", (0.1, 0.26)).summary())
    assert Mixture.report_boxes(recorded, "mix") == [Box("parts", "1, 2 MPa", "± 0.26 MPa, mix")]
    del recorded["bars"]
    assert Mixture.report_boxes(recorded, "mix") == [Box("parts", "1, 2 MPa", "mix")]
    assert Mixture.report_boxes({"parts": [1.0, None]}, "mix") == []


def test_what_states_its_own_summary_is_not_known():
    class Own(Mixture):
        def summary(self):
            return {"other": 1}

    assert "reported" not in vars(Own)


@pytest.mark.parametrize(
    ("kind", "entries"),
    [
        (StiffnessReport,
         "method unit porosity phases C E G nu E_x_relative E_relative E_ratio isotropic xi xi_relative "
         "deviation_invariant bulk shear zener distance_from_cubic universal_anisotropy "
         "log_euclidean_anisotropy E_min E_max bounds "
         "compliance solver expansion error error_relative E_error G_error E_relative_error"),
        (PermeabilityReport,
         "k error porosity grid precision iterations residuals errors converged wraps warnings k_m2 darcy k_mean "
         "darcy_mean edge_mm error_relative pocket_share thermal viscous_tortuosity thermal_tortuosity "
         "hydraulic_tortuosity surface kozeny"),
        (ConductivityReport,
         "k error porosity grid precision iterations residuals errors converged wraps warnings tortuosity of bulk "
         "fluid fractions"),
        (AcousticReport,
         "axis porosity resistivity permeability thermal_permeability tortuosity viscous_tortuosity "
         "thermal_tortuosity viscous_length thermal_length shape layer temperature nrc peak peak_frequency "
         "absorption absorption_at edge_mm grid warnings"),
        (CompressionCurve,
         "name origin points strain_max stress_max unit area_mm2 height_mm density_g_cm3 energies numbers "
         "notes ended"),
        (CrushedBody,
         "name origin points strain_max stress_max unit area_mm2 height_mm density_g_cm3 energies numbers "
         "notes ended grid axis voxels nodes frames plastic_strain_max"),
    ],
)  # fmt: skip
def test_run_records_keep_their_entries_in_their_order(kind, entries):
    assert list(dict.fromkeys(one.path[0] for one in kind.entries())) == entries.split()
