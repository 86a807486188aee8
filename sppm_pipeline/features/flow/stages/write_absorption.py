"""``write.absorption``: curve, table and parameters of sound absorption."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, Stage, options
from sppm_pipeline.features.flow.acoustics import AcousticReport, air

CURVE = np.geomspace(50.0, 6400.0, 281)
"""Frequencies of the curve, Hz: 40 an octave."""


@dataclass(frozen=True, kw_only=True)
class WriteAbsorption(Stage):
    """Draw the sound absorption of a layer over frequency, with its third-octave bands, and write the numbers.

    Beside the chart stand two files of the same name: ``.csv`` has the frequency (Hz), the absorption and the impedance
    of the surface over that of air (real, imaginary) of the curve; ``.txt`` has the parameters of the model in the
    units that acoustic programs ask for, the noise reduction coefficient and the absorption of the third octaves.
    Charts are drawn by matplotlib: ``pip install 'sppm-pipeline[plot]'``.
    """

    name: ClassVar[str] = "write.absorption"
    libraries: ClassVar[tuple[str, ...]] = ("matplotlib",)

    path: str = options.write_path("absorption.png", suffixes=options.CHARTS)
    title: str = options.title("", note="above the chart")

    def check_options(self) -> None:
        """A chart that can be drawn."""
        from sppm_pipeline.pictures import check_chart

        check_chart(self.path, title=self.title)

    def run(self, context: Context, report: AcousticReport) -> None:
        """Compute the curve, draw and write."""
        from sppm_pipeline.pictures import Series, chart

        curve, impedance = report.absorption(CURVE)
        bands = report.bands()
        series = [
            Series(CURVE, curve, f"{report.layer:g} mm, NRC {report.nrc:.2f}", "line"),
            Series(list(bands), list(bands.values()), "third octaves"),
        ]
        picture = chart(
            series, self.path, title=self.title, x_label="frequency / Hz", y_label="sound absorption", log_x=True
        )
        context.output(self.path).write_bytes(picture)
        stem = PurePosixPath(self.path)
        relative = impedance / air(report.temperature).impedance
        rows = zip(CURVE, curve, relative.real, relative.imag, strict=True)
        lines = ["frequency,absorption,impedance_real,impedance_imaginary"]
        lines += [",".join(f"{value:.6g}" for value in row) for row in rows]
        context.output(str(stem.with_suffix(".csv"))).write_text("\n".join(lines) + "\n", encoding="ascii")
        context.output(str(stem.with_suffix(".txt"))).write_text(_card(report, bands), encoding="ascii")


def _card(report: AcousticReport, bands: dict[int, float]) -> str:
    """Parameters and bands, one a line."""
    entries = {
        "porosity": (report.porosity, "1"), "static flow resistivity": (report.resistivity, "Pa s/m^2"),
        "tortuosity": (report.tortuosity, "1"), "viscous characteristic length": (1e3 * report.viscous_length, "um"),
        "thermal characteristic length": (1e3 * report.thermal_length, "um"),
        "static viscous permeability": (report.permeability, "m^2"),
        "static thermal permeability": (report.thermal_permeability, "m^2"),
        "static viscous tortuosity": (report.viscous_tortuosity, "1"),
        "static thermal tortuosity": (report.thermal_tortuosity, "1"), "layer": (report.layer, "mm"),
        "temperature": (report.temperature, "degrees Celsius"), "noise reduction coefficient": (report.nrc, "1"),
    }  # fmt: skip
    lines = [f"{name}: {value:.6g} {unit}" for name, (value, unit) in entries.items()]
    return "\n".join([*lines, *(f"absorption at {band} Hz: {value:.3f}" for band, value in bands.items())]) + "\n"
