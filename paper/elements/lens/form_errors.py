"""Fig. 2g: form errors of both surfaces, and what they cost a reconstruction that does not know them."""

from __future__ import annotations

from typing import Any

import numpy as np

from lensdesign import Lens, SurfacePerturbation, load_design
from lensdesign.analysis import form_errors
from lensdesign.analysis.form_error import fitted, terms
from lensdesign.files.surface_figures import surface_figure
from lensdesign.lens.surface_figure_source import TEST_WAVELENGTH_UM
from paper.element import DESIGNS, PAPER_DESIGN, Element, Made, Number, Work
from paper.style import panel, styled_figure

DESIGN = "measured_singlet.toml"
PAPER_WAVES = (0.279, 0.427)
NAMES = ("entrance", "exit")
SAMPLES = 301
HEIGHTS_MM = (0.0, 1.4)


def figure_2g(work: Work) -> Made:
    """Maps, their errors, and the wavefront that is left when the nominal lens is taken for the made one."""
    made = load_design(DESIGNS / DESIGN)
    numbers = []
    for name, error, said in zip(NAMES, form_errors(made), PAPER_WAVES, strict=True):
        numbers += [
            Number(f"peak-to-valley of the {name} surface", error.pv_waves, "λ at 633 nm", said, 5e-4),
            Number(f"root mean square of the {name} surface", error.rms_waves, "λ at 633 nm"),
        ]
    for height in HEIGHTS_MM:
        waves, ratio = _wavefront(work.lens, made, height)
        numbers += [
            Number(f"wavefront that they leave, {height:g} mm off the axis", waves, "λ rms at 532 nm"),
            Number(f"Strehl ratio of the reconstruction there, {height:g} mm off the axis", ratio),
        ]
    picture = work.picture(
        _maps(made), "Sag error of both surfaces, piston and tilt removed: the example in designs/."
    )
    difference = (
        "The paper's maps are not published as data. `designs/measured_singlet.toml` contains two random "
        "examples, scaled to the paper's peak-to-valley errors. A reconstruction that assumes the "
        "nominal lens keeps 96 % of the Strehl ratio. Such surfaces therefore do not explain why the "
        "paper resolves 0.87 µm where 0.532 µm is expected. A reconstruction that uses the maps loses "
        "nothing."
    )
    commands = (f"lensdesign check designs/{DESIGN}", f"lensdesign draw designs/{DESIGN} -o DIR")
    return Made(tuple(numbers), commands, difference, (picture,))


def _wavefront(nominal: Lens, made: Lens, height_mm: float) -> tuple[float, float]:
    """Root mean square and Strehl ratio of what is left, shift and focus taken out."""
    from wavesim import PupilSampler, SystemState, refocus, rms_waves, strehl

    figures = {
        number: SurfacePerturbation(figure=figure)
        for number, surface in enumerate(made.surfaces)
        if (figure := surface_figure(surface)) is not None
    }
    sampler = PupilSampler(nominal, field_mm=(0.0, height_mm))
    pupil = refocus(sampler.pupil(SystemState(surface_perturbations=figures))).pupil
    return rms_waves(pupil), strehl(pupil)


def _maps(lens: Lens) -> Any:
    figure = styled_figure(8.4, 3.6)
    panels = zip(figure.subplots(1, 2), lens.surfaces, form_errors(lens), NAMES, strict=True)
    for axes, surface, error, name in panels:
        waves, semi = _map_waves(surface)
        reach = float(np.nanmax(np.abs(waves)))
        label = f"sag error (λ = {1e3 * TEST_WAVELENGTH_UM:.0f} nm)"
        panel(figure, axes, waves, 2.0 * semi, "mm", label, "RdBu_r", vmin=-reach, vmax=reach)
        axes.set_title(f"{name} surface: PV {error.pv_waves:.3f} λ, RMS {error.rms_waves:.3f} λ")
    return figure


def _map_waves(surface: Any) -> tuple[Any, float]:
    """Sag error over the clear aperture, best-fit piston and tilt removed; not a number outside."""
    figure, semi = surface_figure(surface), surface.semi_diameter_mm
    assert figure is not None
    at = np.linspace(-1.0, 1.0, SAMPLES)
    x, y = np.meshgrid(at, at)
    inside = np.hypot(x, y) <= 1.0
    points = np.stack([x[inside], y[inside]], axis=-1)
    waves = 1e3 / TEST_WAVELENGTH_UM * figure.sag(*(semi * points.T))
    even = np.full(len(waves), 1.0 / len(waves))
    shown = np.full(x.shape, np.nan)
    shown[inside] = waves - fitted(waves, points, even, "tilt") @ terms(points, "tilt")
    return shown, semi


ELEMENTS = (
    Element(
        "figure-2g",
        "Fig. 2g: form errors of the surfaces",
        "The surfaces as they were ground and polished have peak-to-valley errors of 0.279 λ and 0.427 λ at "
        "633 nm.",
        figure_2g,
        seconds={"quick": 3.0, "full": 3.0},
        designs=(PAPER_DESIGN, DESIGN, "measured_front.csv", "measured_back.csv"),
    ),
)
