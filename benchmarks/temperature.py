"""A lens of glass and one of plastic from 0 to 50 C: what heat does to focal length, spread and wavefront.

The plastic lens has the paper's field, aperture and distances; both are traced as they are at each
temperature, and their wavefronts are those that a reconstruction with the design at 20 C is left with, with
and without refocusing. `-o CHART.png` draws them. Then the thinnest lenses that keep their limits at 20 C,
and from 0 to 50 C.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import DESIGNS
from lensdesign import load_design
from lensdesign.analysis import check_design, first_order
from lensdesign.lens import Lens, lens_at_temperature
from lensdesign.lens.catalogues.thermal import REFERENCE_C
from lensdesign.optimization import load_specification, optimize
from lensdesign.optimization.specification.sections import Environment
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.pupil import RmsWaves
from tolerancing.perturbations import PerturbationBatch, PerturbedParameter

TEMPERATURES_C = (0.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0)
HEIGHTS_MM = (0.0, 1.0)
HEAT = PerturbedParameter(target="environment", parameter="temperature_c")
PLASTIC = "E48R"


def main() -> None:
    """Measure, print, and draw where asked for."""
    parser = argparse.ArgumentParser(description="A lens of glass and one of plastic from 0 to 50 C.")
    parser.add_argument("-o", "--output", type=Path, help="chart to draw")
    output = parser.parse_args().output
    found = {name: table(lens) for name, lens in lenses().items()}
    for name, rows in found.items():
        heights = " and ".join(f"{height:g} mm" for height in HEIGHTS_MM)
        print(f"{name}: focal length (mm), largest spread (°), waves rms at {heights} refocused, and not")
        for temperature, row in zip(TEMPERATURES_C, rows, strict=True):
            print(f"{temperature:4g} C  " + "  ".join(f"{value:8.4f}" for value in row))
    if output is not None:
        draw(found, output)
    print("thinnest lens: thickness (mm); largest spread (°) and footprint (mm) at 0 and 50 C; seconds")
    for glass in ("N-BK7", PLASTIC, "PMMA"):
        for words, environment in (("20 C", None), ("0 to 50 C", Environment(temperatures_c=(0.0, 50.0)))):
            print(f"{glass:6} for {words:9}  {thinnest(glass, environment)}")


def thinnest(glass: str, environment: Environment | None) -> str:
    """The thinnest lens of a glass, and what it does at the ends of the range."""
    asked = load_specification(DESIGNS / "thinnest_singlet_spec.toml").with_surface(0, material=glass)
    began = time.process_time()
    lens = optimize(asked.replaced(environment=environment)).lens
    seconds = time.process_time() - began
    hot = [check_design(lens_at_temperature(lens, t)) for t in (TEMPERATURES_C[0], TEMPERATURES_C[-1])]
    spread = max(report.max_spread_deg for report in hot)
    footprint = max(max(report.footprint_radius_mm) for report in hot)
    return f"{lens.exit_vertex_z_mm:.3f}; {spread:.3f}, {footprint:.2f}; {seconds:.1f}"


def lenses() -> dict[str, Lens]:
    """The feasible sibling of the paper's lens, and what its specification gives for a plastic."""
    text = (DESIGNS / "feasible_singlet_spec.toml").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "spec.toml"
        path.write_text(text.replace('"N-BK7"', f'"{PLASTIC}"'), encoding="utf-8")
        plastic = optimize(load_specification(path)).lens
    return {"N-BK7": load_design(DESIGNS / "feasible_singlet.toml"), PLASTIC: plastic}


def table(lens: Lens) -> NDArray[np.float64]:
    """Focal length, largest spread, wavefront errors refocused and not, shape (temperatures, 6)."""
    context = Context(lens, Sampling(pupil_samples=64))
    change = np.array(TEMPERATURES_C)[:, None] - REFERENCE_C
    batch = PerturbationBatch((HEAT,), change)
    rows = []
    for temperature in TEMPERATURES_C:
        hot = lens_at_temperature(lens, temperature)
        rows.append((first_order(hot).efl_mm, check_design(hot).max_spread_deg))
    merits = [
        RmsWaves(kind="rms_waves", at_most=1.0, field_mm=(height, 0.0), refocus=refocus)
        for refocus in (True, False)
        for height in HEIGHTS_MM
    ]
    return np.column_stack([np.array(rows), *(m.scores(context, batch) for m in merits)])


def draw(found: dict[str, NDArray[np.float64]], output: Path) -> None:
    """Wavefront errors against temperature."""
    from lensdesign.plots.style import SERIES, styled_figure
    from tolerancing.report.figures.style import chart_style, write_figure

    with chart_style():
        figure = styled_figure(6.4, 3.2)
        axis = figure.subplots()
        for (name, rows), color in zip(found.items(), SERIES, strict=False):
            # Nothing is left at 20 C, which a logarithmic axis has no place for.
            shown = np.where(rows > 1e-9, rows, np.nan)
            axis.semilogy(TEMPERATURES_C, shown[:, 4], "o-", color=color, label=f"{name}, as mounted")
            axis.semilogy(TEMPERATURES_C, shown[:, 2], "o--", color=color, label=f"{name}, refocused")
        axis.set_xlabel("temperature (°C)")
        axis.set_ylabel("wavefront error on the axis (waves rms)")
        figure.legend(loc="outside right upper")
    write_figure(figure, output)


if __name__ == "__main__":
    main()
