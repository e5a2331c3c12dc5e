"""Fig. 2e: spectra of retrieved fields in image space, with the circle of the pixels."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.fft

from lensdesign.analysis import match
from paper.element import Element, Made, Number, Work
from paper.elements.results.retrieval import SETTINGS
from paper.style import RED, styled_figure
from paper.twin import Thing, retrieved, twin
from wavesim import Field, engine_for
from wavesim.fields import spectrum_support

if TYPE_CHECKING:
    from matplotlib.figure import Figure

THINGS: dict[Thing, str] = {"chart": "USAF chart", "tissue": "tissue"}
DECADES = 5.0


def figure_2e(work: Work) -> Made:
    """Spectra of both objects' retrieved fields."""
    scale, iterations = work.settings["twin"], work.settings["iterations"]
    limit = match(work.lens, work.lens.wavelengths_um[0]).highest_frequency_lp_per_mm
    fields, numbers = {}, []
    for thing, name in THINGS.items():
        work.progress(f"{iterations} iterations, {name}")
        field = retrieved(scale, thing, "forward model", iterations).field
        support = spectrum_support(field.values, field.grid.pitch_mm, limit, fraction=0.999)
        finer = _before_the_pixels(scale, thing, limit)
        fields[name] = field
        numbers += [
            Number(f"highest frequency, {name}: circle of 99.9 %", support.frequency_within_per_mm, "lp/mm"),
            Number(f"energy beyond {limit:.2f} lp/mm, {name}, retrieved", support.fraction_beyond),
            Number(f"energy beyond it in the light itself, {name}", finer),
        ]
    numbers.insert(0, Number("circle of the pixels, 1 / (2 Δ)", limit, "lp/mm", 156.0, 0.5, digits=5))
    picture = work.picture(
        _spectra(fields, limit),
        "Spectra of the retrieved fields, over five decades of energy; red: the circle of the pixels.",
    )
    difference = (
        "The light of both objects lies within the circle. The spectrum shows the field stop through the "
        "lens, with the object in it, because a direction behind this lens corresponds to a position in "
        "front of it. One or two thousandths of the retrieved energy lie outside, scattered by the "
        "retrieval. The light itself, on samples twice as fine as the pixels, has only a few millionths "
        "of its energy there. The square ends at the limit of the pixels."
    )
    return Made(tuple(numbers), ("python -m paper --only figure-2e",), difference, (picture,))


def _before_the_pixels(scale: float, thing: Thing, limit_per_mm: float) -> float:
    """Share of the light's energy on the first plane, on samples half as wide as pixels, beyond a limit."""
    case = twin(scale, thing)
    scene = case.engine.scene
    grid = scene.exit_grid
    fine = replace(grid, shape=tuple(2 * n for n in grid.shape), pitch_mm=0.5 * grid.pitch_mm)
    engine = engine_for(replace(scene, exit_grid=fine), "eikonal", error=0.1)
    light = engine.forward(case.light.with_values(case.light.values * case.transmission))
    return spectrum_support(light.values, fine.pitch_mm, limit_per_mm).fraction_beyond


def _spectra(fields: dict[str, Field], limit: float) -> Figure:
    figure = styled_figure(8.6, 4.1)
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    for axes, (name, field) in zip(figure.subplots(1, len(fields)), fields.items(), strict=True):
        energy = np.abs(scipy.fft.fftshift(scipy.fft.fft2(field.values))) ** 2
        reach = 0.5 / field.grid.pitch_mm
        shown: Any = np.log10(np.maximum(energy / energy.max(), 10.0**-DECADES))
        extent = (-reach, reach, -reach, reach)
        drawn = axes.imshow(shown, origin="lower", extent=extent, cmap="inferno", interpolation="antialiased")
        axes.plot(limit * np.cos(turn), limit * np.sin(turn), color=RED, lw=1.3)
        axes.set(xlim=(-1.06 * reach, 1.06 * reach), ylim=(-1.06 * reach, 1.06 * reach))
        axes.set(xlabel="$f_x$ (lp/mm)", ylabel="$f_y$ (lp/mm)", title=name, facecolor="black")
        axes.grid(visible=False)
        bar = figure.colorbar(drawn, ax=axes, fraction=0.046, pad=0.03)
        bar.set_label("energy over the largest, powers of ten")
    return figure


FIGURE_2E = Element(
    "figure-2e",
    "Fig. 2e: spectra in image space",
    "The spectra of chart and tissue retrieved in image space extend to 156 lp/mm, the limit of the pixels.",
    figure_2e,
    SETTINGS,
    {"quick": 40.0, "full": 250.0},
)
